"""`sada-gym replay`: a video of how the agent fails."""

from __future__ import annotations

from pathlib import Path

from rich.status import Status

from sada_gym.cli.console import (
    application_option,
    err,
    errors_as_sentences,
    json_option,
    option,
    print_json,
    run_argument,
    say,
)


def replay(
    run: Path = run_argument(),
    out_file: Path = option(
        ..., "The video; the ending chooses the format.", "--out", metavar="FILE.gif|FILE.mp4"
    ),
    worst: int | None = option(
        None, "Show this many of the samples with the lowest scores.", shown="1"
    ),
    sample: int | None = option(
        None, "Show this one sample: its row in samples.npz, from 0.", metavar="I"
    ),
    seconds: float = option(10.0, "About how many seconds each sample takes."),
    application: str | None = application_option("RUN"),
    as_json: bool = json_option(),
) -> None:
    """Replay samples of a run as a video that shows how the agent fails.

    The video shows how failed episodes end, and says why. Each score must equal the one that the
    run stored. A GIF has at most 2 MB for ten seconds.
    """
    with errors_as_sentences():
        from sada_gym.analyses.replay import video as videos
        from sada_gym.experiment.progress import COMPILING, will_compile

        status = Status("Opening the run", console=err)
        compiling = False

        def progress(stage: videos.Stage, done: int, total: int) -> None:
            nonlocal compiling
            if stage == "play" and not compiling and will_compile():
                compiling = True
                say(COMPILING, console=err)
            text = {
                "open": "Opening the run",
                "play": f"Replaying sample {done + 1} of {total}",
                "write": f"Writing {out_file.name}",
            }[stage]
            if err.is_terminal:
                status.update(text)
            else:
                say(text, console=err)

        if err.is_terminal:
            status.start()
        try:
            video = videos.replay(
                run,
                worst=worst,
                sample=sample,
                out=out_file,
                application=application,
                seconds=seconds,
                on_progress=progress,
            )
        finally:
            status.stop()
    if as_json:
        parts = ("path", "size", "seconds", "samples")
        print_json({part: getattr(video, part) for part in parts})
        return
    for played in video.samples:
        say(f"Sample {played.sample}: Q = {played.score:.3g}; {'; '.join(played.endings)}")
        if played.score != played.stored:
            say(
                f"  The run stored {played.stored!r}: this processor rounds differently, or the "
                "simulator gives another score each time."
            )
    say(f"{video.path}: {video.seconds:.1f} s, {video.size / 1e6:.2f} MB")
