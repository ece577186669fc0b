"""A stand-in for Blender that draws grey pictures and misbehaves in ways that it is told.

It reads its ways from `FAKE_BLENDER`, words between commas, and leaves notes in the folder
`FAKE_BLENDER_NOTES`.
"""

import io
import json
import os
import sys
import time
from pathlib import Path

from PIL import Image

WAYS = os.environ.get("FAKE_BLENDER", "").split(",")
NOTES = Path(os.environ["FAKE_BLENDER_NOTES"])


def say(**message):
    sys.stdout.buffer.write(b"sada-gym:" + json.dumps(message).encode() + b"\n")
    sys.stdout.buffer.flush()


def once(note):
    """Whether this is the first time in the whole test."""
    path = NOTES / note
    first = not path.exists()
    path.touch()
    return first


if "--version" in sys.argv:
    if "mute" not in WAYS:
        print("Color management: using fallback mode")
        print("Blender 2.79 (sub 0)" if "old" in WAYS else "Blender 4.2.1 LTS")
    sys.exit()

(NOTES / f"pid-{os.getpid()}").touch()
if "rubbish" in WAYS:
    sys.stdout.buffer.write(b"Read prefs: \xff\xfe\x00\n" + b"x" * 200_000 + b"\nFra:1 Mem:9M\n")
if "no-cycles" in WAYS:
    say(error='TypeError: enum "CYCLES" not found')
    sys.exit()
say(folder="")
while line := sys.stdin.buffer.readline():
    order = json.loads(line)
    for _, kind, count in order["arrays"]:
        sys.stdin.buffer.read(count * {"f": 4, "i": 4}[kind])
    if "model" in order:
        say(bytes=0)
        continue
    (NOTES / "drawn").open("a").write(f"{order['seed']}\n")
    if "rubbish" in WAYS:
        print("Fra:1 Mem:10.5M | Rendering 1 / 16 samples")
    if "dies" in WAYS or ("dies-once" in WAYS and once("dies-once")):
        print("Segmentation fault, they say", file=sys.stderr)
        os._exit(11)
    if "hangs" in WAYS:
        time.sleep(600)
    if "fails" in WAYS:
        say(error="RuntimeError: cannot save: No space left on device")
        continue
    file = io.BytesIO()
    level = order["seed"] % 256
    Image.new("RGB", (order["size"],) * 2, (level,) * 3).save(file, "PNG")
    content = file.getvalue()
    if "truncates" in WAYS:
        content = content[:40]
    say(bytes=len(content))
    if "dies-halfway" in WAYS:
        sys.stdout.buffer.write(content[:10])
        sys.stdout.buffer.flush()
        os._exit(1)
    sys.stdout.buffer.write(content)
    sys.stdout.buffer.flush()
