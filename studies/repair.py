"""Does training on failures help? Three agents, four kinds of extra training, judged afterwards.

    python -m studies.repair --out runs/repair

It does what is missing and prints the tables. `--agents lander` takes one agent, `--table` prints
what is there.

Each arm goes on from the same agent with the same number of extra steps, but in other worlds:
nominal ones, uniform ones, failures (new worlds of a `level-set` that attacked the agent), or half
failures and half uniform ones. Then it is judged: in nominal worlds, in uniform worlds (the same
for all), and by new attacks of `level-set` and `bbgan`. OUT/AGENT/ARM-SEED.json is written as each
is done; a second call goes on where the first stopped. `none` is the agent as it was.
"""

from __future__ import annotations

import argparse
import json
import time
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from stable_baselines3 import PPO
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.vec_env import VecMonitor, VecNormalize

from sada_gym import GymnasiumApplication, agents, attack
from sada_gym.analyses.training import FailureCurriculum, curriculum_vec_env
from sada_gym.analyses.training.lockstep import curriculum_starts
from sada_gym.application import Application
from sada_gym.envs.driving.agent import network as driver_network
from sada_gym.envs.driving.application import DrivingApplication
from sada_gym.envs.driving.world.weather import NAMES, TRAINING_WEATHERS
from sada_gym.envs.robot.agent import network as robot_network
from sada_gym.envs.robot.application import RobotApplication
from sada_gym.envs.wrapped import Keyword, ObservationDelay
from sada_gym.evaluations import fools
from sada_gym.foundations.determinism import generators_kept, one_thread
from sada_gym.foundations.files import write_file
from sada_gym.measures.rates import wilson_interval
from studies.means import mean_text
from studies.training.common import Report
from studies.training.driving.imitation import fit, gather
from studies.training.driving.recipe import RECIPES
from studies.training.imitation import Examples, dagger
from studies.without_hits import without_hits

ARMS: Mapping[str, Mapping[str, float]] = {
    "nominal": {"nominal": 1.0},
    "uniform": {"uniform": 1.0},
    "failures": {"failures": 1.0},
    "mixed": {"failures": 0.5, "uniform": 0.5},
}
SEEDS = (0, 1, 2)
ATTACKERS = ("level-set", "bbgan")
WORST = 0.1
"""The share of uniform worlds whose mean score is CVaR."""

_JUDGED = 10_000
"""The seed of the worlds in which all are judged."""
_ATTACKED = 100
"""The new attacks have other seeds than those that the training worlds came from."""


@dataclass(frozen=True)
class Effort:
    """How much is spent on an agent: extra steps, worlds of each kind, queries and samples."""

    steps: int
    nominal: int
    uniform: int
    budget: int
    samples: int


class Subject(ABC):
    """An agent that is repaired."""

    name: str
    effort: Effort
    suffix = ".safetensors"

    @abstractmethod
    def application(self, agent: Any) -> Application:
        """Return the application with an agent, or with the file of one."""

    @abstractmethod
    def base(self, folder: Path) -> Any:
        """Return the agent as it was; what has to be trained is kept in the folder."""

    @abstractmethod
    def repair(
        self, base: Any, source: Path, shares: Mapping[str, float], seed: int, file: Path
    ) -> Any:
        """Train on, write the agent to a file, and return its path."""

    def nominal(self, count: int) -> tuple[Any, list[int]]:
        """Return nominal worlds, (count, d), and their seeds."""
        mu = np.zeros((count, len(self.application(None).parameters)), np.float32)
        return mu, list(range(_JUDGED, _JUDGED + count))


class Lander(Subject):
    """PPO on LunarLander-v3, trained without wind, as in `examples/lunar_lander.py`."""

    name, suffix = "lander", ".zip"
    effort = Effort(steps=300_000, nominal=200, uniform=1_000, budget=1_000, samples=100)
    base_steps = 1_000_000
    envs = 16

    def application(self, agent: Any) -> GymnasiumApplication:
        return GymnasiumApplication(
            "LunarLander-v3",
            agent=(lambda _: 0) if agent is None else agent,
            parameters={
                "gravity": Keyword(-11.9, -4.0, unit="m/s²"),
                "wind_power": Keyword(0.0, 20.0, nominal=0.0),
                "turbulence_power": Keyword(0.0, 2.0, nominal=0.0),
                "delay": ObservationDelay(0, 5, unit="steps"),
            },
            score=("return", -300.0, 300.0),
            fooling_threshold=0.5,
            env_kwargs={"enable_wind": True},
        )

    def base(self, folder: Path) -> Path:
        file, unfinished = folder / "base.zip", folder / "unfinished.zip"
        if file.exists():
            return file
        env = make_vec_env("LunarLander-v3", n_envs=self.envs, seed=0)
        with one_thread(), generators_kept():
            if unfinished.exists():  # it goes on with other draws than it would have had
                agent = PPO.load(unfinished, env=env, device="cpu")
            else:
                agent = PPO(
                    "MlpPolicy",
                    env,
                    n_steps=1024,
                    n_epochs=4,
                    gamma=0.999,
                    gae_lambda=0.98,
                    ent_coef=0.01,
                    seed=0,
                    device="cpu",
                )
            while (left := self.base_steps - agent.num_timesteps) > 0:
                agent.learn(min(left, 50_000), reset_num_timesteps=False)
                _save(agent.save, unfinished)
                print(f"the agent as it was: {agent.num_timesteps:,} steps", flush=True)
        unfinished.rename(file)
        return file

    def repair(
        self, base: Path, source: Path, shares: Mapping[str, float], seed: int, file: Path
    ) -> Path:
        application = self.application(base)
        with one_thread(), generators_kept():
            env = make_vec_env(
                lambda: FailureCurriculum(application, source, shares=shares), n_envs=self.envs
            )
            agent = PPO.load(base, env=env, device="cpu")
            agent.set_random_seed(1_000 * (seed + 1))
            agent.learn(self.effort.steps)
            env.close()
        return _save(agent.save, file)

    def nominal(self, count: int) -> tuple[Any, list[int]]:
        nominal = self.application(None).nominal
        assert nominal is not None
        return np.repeat(nominal[None], count, axis=0), list(range(_JUDGED, _JUDGED + count))


class Robot(Subject):
    """The shipped `ppo`, which was trained in the middle of all ranges."""

    name = "robot"
    effort = Effort(steps=400_000, nominal=100, uniform=800, budget=1_000, samples=100)
    envs = 64

    def application(self, agent: Any) -> RobotApplication:
        return RobotApplication(agent="ppo" if agent is None else agent)

    def base(self, folder: Path) -> str:  # noqa: ARG002
        return "ppo"

    def repair(
        self, base: str, source: Path, shares: Mapping[str, float], seed: int, file: Path
    ) -> Path:
        tasks = curriculum_vec_env("SADA-Robot-v0", source, shares=shares, num_envs=self.envs)
        env = VecNormalize(VecMonitor(tasks), norm_obs=False, gamma=0.98)
        with one_thread():
            agent = robot_network.new_model(
                seed,
                env,
                n_steps=64,
                batch_size=1_024,
                n_epochs=6,
                learning_rate=2e-4,
                gamma=0.98,
                ent_coef=0.0,
                target_kl=0.03,
            )
            known = agents.load(base, "SADA-Robot").policy.state_dict()
            agent.policy.load_state_dict(known)
            with generators_kept():
                agent.set_random_seed(1_000 * (seed + 1))
                agent.learn(self.effort.steps, callback=Report("arrived"))
        env.close()
        return _save(lambda part: robot_network.save(agent, part), file)


class Driver(Subject):
    """The shipped `cil` in the task `one_curve`; an expert shows it other worlds."""

    name = "driver"
    effort = Effort(steps=16_000, nominal=40, uniform=300, budget=250, samples=60)
    rounds = 4

    def application(self, agent: Any) -> DrivingApplication:
        return DrivingApplication("one_curve", agent="cil" if agent is None else agent)

    def base(self, folder: Path) -> str:  # noqa: ARG002
        return "cil"

    def repair(
        self, base: str, source: Path, shares: Mapping[str, float], seed: int, file: Path
    ) -> Path:
        """Gather as many nominal examples as extra ones first: what it learnt them by is lost."""
        recipe: Any = replace(
            RECIPES["cil"], rounds=self.rounds, steps=self.effort.steps // self.rounds
        )
        starts = curriculum_starts(
            "SADA-Driving", source, shares=shares, starts=recipe.distribution
        )
        extra = replace(recipe, distribution=starts)
        rng, driver = np.random.default_rng(seed), agents.load(base, "SADA-Driving")
        examples = Examples(2 * self.effort.steps)
        with one_thread(), generators_kept():
            gather(driver, replace(recipe, steps=self.effort.steps), examples, 0.5, rng)
            dagger(
                extra,
                lambda share: f"{gather(driver, extra, examples, share, rng)} left their lane",
                lambda epochs: fit(driver, examples, extra, epochs, rng),
            )
        return _save(lambda part: driver_network.save(driver, part), file)

    def nominal(self, count: int) -> tuple[Any, list[int]]:
        space = DrivingApplication.parameters
        physical = [[1.4, -15.0, i % TRAINING_WEATHERS + 0.5] for i in range(count)]
        assert len(NAMES) >= TRAINING_WEATHERS
        return space.normalised(physical), list(range(_JUDGED, _JUDGED + count))


SUBJECTS = (Lander(), Robot(), Driver())


def run(subject: Subject, arm: str, seed: int, out: Path) -> dict[str, Any]:
    """Repair an agent by one arm and judge it, or read what was found before."""
    folder = out / subject.name
    file = folder / f"{arm}-{seed}.json"
    effort = asdict(subject.effort)
    if file.exists():
        found: dict[str, Any] = json.loads(file.read_text(encoding="utf-8"))
        if found["effort"] != effort:
            raise SystemExit(f"{file} was made by {found['effort']}, not {effort}. Name another.")
        return found
    folder.mkdir(parents=True, exist_ok=True)
    started = time.process_time()
    agent = base = subject.base(folder)
    if arm != "none":
        source = _attacked(subject, base, "level-set", seed, folder / f"source-{seed}")
        begun = time.process_time()
        agent = folder / f"{arm}-{seed}{subject.suffix}"
        if not agent.exists():
            subject.repair(base, source, ARMS[arm], seed, agent)
        print(f"{arm} {seed}: trained in {time.process_time() - begun:.0f} s", flush=True)
    found = {"agent": subject.name, "arm": arm, "seed": seed, "effort": effort}
    found |= _judged(subject, agent, seed, folder / f"{arm}-{seed}")
    found["cpu_s"] = time.process_time() - started
    write_file(file, json.dumps(found, indent=1).encode())
    return found


def _attacked(subject: Subject, agent: Any, adversary: str, seed: int, folder: Path) -> Path:
    attack(
        subject.application(agent),
        adversary,
        budget=subject.effort.budget,
        samples=subject.effort.samples,
        seed=seed,
        options=without_hits(adversary),
        out=folder,
        resume=True,
        pictures=False,
        progress=False,
    )
    return folder


def _judged(subject: Subject, agent: Any, seed: int, folder: Path) -> dict[str, Any]:
    application, effort = subject.application(agent), subject.effort
    nominal = application.evaluate(*subject.nominal(effort.nominal)).score
    rng = np.random.default_rng(_JUDGED)
    mu = rng.uniform(-1.0, 1.0, (effort.uniform, len(application.parameters))).astype(np.float32)
    seeds = rng.integers(2**31, size=len(mu)).tolist()
    uniform = application.evaluate(mu, seeds).score
    judged: dict[str, Any] = {
        "nominal": float(nominal.mean()),
        "uniform": float(uniform.mean()),
        "fooled": int(fools(uniform, application.fooling_threshold).sum()),
        "worlds": len(uniform),
        "cvar": float(np.sort(uniform)[: max(1, round(WORST * len(uniform)))].mean()),
        "samples": effort.samples,
    }
    for adversary in ATTACKERS:
        place = folder / adversary
        _attacked(subject, agent, adversary, _ATTACKED + seed, place)
        report = json.loads((place / "result.json").read_text(encoding="utf-8"))
        judged[adversary] = round(report["afr"] * effort.samples)
    return judged


def _save(save: Any, file: Path) -> Path:
    """Write an agent's file whole or not at all."""
    part = file.with_name(f"{file.stem}.part{file.suffix}")
    save(part)
    part.rename(file)
    return file


def table(subject: Subject, out: Path) -> Iterator[str]:
    """Yield the table of an agent: means over the seeds, with 95 % intervals."""
    yield f"### {subject.name}: {subject.effort.steps:,} extra steps"
    yield ""
    names = [f"{name}, %" for name in ("uniform fooled", *ATTACKERS)]
    yield f"| extra training | seeds | nominal Q | {' | '.join(names)} | worst 10 %: Q |"
    yield "| --- " * (4 + len(names)) + "|"
    for arm in ("none", *ARMS):
        found = []
        for seed in SEEDS:
            with suppress(FileNotFoundError):
                path = out / subject.name / f"{arm}-{seed}.json"
                found.append(json.loads(path.read_text(encoding="utf-8")))
        if found:
            rates = [_rates(found, "fooled", "worlds")]
            rates += [_rates(found, adversary, "samples") for adversary in ATTACKERS]
            yield (
                f"| {arm} | {len(found)} | {mean_text([f['nominal'] for f in found], 2)} | "
                f"{' | '.join(rates)} | {mean_text([f['cvar'] for f in found], 2)} |"
            )
    yield ""


def _rates(found: list[dict[str, Any]], fooled: str, trials: str) -> str:
    """Write a pooled rate with Wilson's 95 % interval, and the rates of the seeds."""
    count, total = sum(f[fooled] for f in found), sum(f[trials] for f in found)
    low, high = wilson_interval(count, total)
    each = ", ".join(f"{100 * f[fooled] / f[trials]:.0f}" for f in found)
    return f"{100 * count / total:.0f} ({100 * low:.0f} to {100 * high:.0f}); {each}"


def main() -> None:
    """Do what is missing, and print the tables."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    names = [subject.name for subject in SUBJECTS]
    parser.add_argument("--out", type=Path, default=Path("runs/repair"))
    parser.add_argument("--agents", nargs="*", choices=names, default=names)
    parser.add_argument("--seeds", type=int, nargs="*", default=SEEDS)
    parser.add_argument("--table", action="store_true", help="only print what is there")
    options = parser.parse_args()
    for subject in SUBJECTS:
        if subject.name not in options.agents:
            continue
        for seed in () if options.table else options.seeds:
            for arm in ("none", *ARMS):
                found = run(subject, arm, seed, options.out)
                print(json.dumps(found), flush=True)
        print("\n".join(table(subject, options.out)), flush=True)


if __name__ == "__main__":
    main()
