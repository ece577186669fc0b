"""Attack a lander, train it on where it failed, and attack the fixed one.

    pip install -c constraints.txt '.[examples]'    # Box2D
    python examples/lunar_lander.py         # trains lander.zip and attacks it
    python examples/fix_lunar_lander.py

It takes some minutes and writes fixed.zip beside this file.
"""

from pathlib import Path

import torch
from stable_baselines3 import PPO
from stable_baselines3.common.env_util import make_vec_env

from sada_gym import FailureCurriculum, attack

FOLDER = Path(__file__).parent
BUDGET = 1_000
TRAINING_STEPS = 300_000
TOML = """
environment = "LunarLander-v3"
agent = "{agent}"
score = ["return", -300.0, 300.0]
fooling_threshold = 0.5
env_kwargs = {{ enable_wind = true }}

[parameters]
gravity = {{ kind = "keyword", low = -11.9, high = -4.0, unit = "m/s²" }}
wind_power = {{ kind = "keyword", low = 0.0, high = 20.0, nominal = 0.0 }}
turbulence_power = {{ kind = "keyword", low = 0.0, high = 2.0, nominal = 0.0 }}
delay = {{ kind = "observation-delay", low = 0, high = 5, unit = "steps" }}
"""


def find_failures(agent: str) -> str:
    """Attack an agent's file in this folder, and return the TOML file that says what mu sets."""
    toml = FOLDER / f"{agent}.toml"
    toml.write_text(TOML.format(agent=f"{agent}.zip"), encoding="utf-8")
    folder = f"runs/fix-lander/{agent}"
    run = attack(str(toml), "level-set", budget=BUDGET, out=folder, resume=True)
    print(f"{run.result.afr:.0%} of the new worlds fool {agent}")
    return str(toml)


def main() -> None:
    """Attack, train on, attack."""
    torch.set_num_threads(1)  # small networks train several times faster in one thread
    if not (FOLDER / "lander.zip").exists():
        PPO("MlpPolicy", "LunarLander-v3", device="cpu").learn(TRAINING_STEPS).save(
            FOLDER / "lander.zip"
        )
    toml = find_failures("lander")

    env = make_vec_env(lambda: FailureCurriculum(toml, "runs/fix-lander/lander"), n_envs=16)
    PPO.load(FOLDER / "lander.zip", env=env, device="cpu").learn(TRAINING_STEPS).save(
        FOLDER / "fixed.zip"
    )
    find_failures("fixed")


if __name__ == "__main__":
    main()
