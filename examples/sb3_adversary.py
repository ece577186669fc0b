"""PPO of Stable-Baselines3 as the adversary, on a counted budget that survives being killed.

One proposal an episode makes the policy a sampler of failures. With more proposals an episode the
policy sees the last mu and its score, and searches: what it finds is shown as an anytime curve.

Run it, stop it, and run it again, which repeats no evaluation: python examples/sb3_adversary.py
"""

from __future__ import annotations

from contextlib import suppress

import numpy as np
from stable_baselines3 import PPO

import sada_gym
from sada_gym.evaluation.env import OracleVectorEnv
from sada_gym.measures.rates import attack_fooling_rate
from sada_gym.measures.search import anytime
from sada_gym.oracle import BudgetExhausted, Evaluations, Oracle
from sada_gym.sb3 import SB3VecEnv, sample_policy

ENV_ID = "SADA-Analytic-v0"
BUDGET = 8_192
ENVS = 64  # a step asks for so many worlds at once


def train(horizon: int) -> tuple[PPO, Evaluations]:
    """Train with so many proposals an episode: the model, and all that it asked."""
    known = [0]
    # the same seed asks for the same worlds, so a second run finds them in the store
    with Oracle(
        ENV_ID,
        budget=BUDGET,
        seed=0,
        store="sb3.sqlite",
        progress=lambda done, total, from_store: known.append(from_store),  # noqa: ARG005
    ) as oracle:
        env = SB3VecEnv(OracleVectorEnv(oracle, ENVS, horizon=horizon))
        model = PPO(
            "MlpPolicy",
            env,
            n_steps=max(2, horizon),
            batch_size=128,
            n_epochs=20,
            learning_rate=1e-2,
            gamma=0.0 if horizon == 1 else 0.9,  # with one proposal there is no future
            seed=0,
            device="cpu",
        )
        with suppress(BudgetExhausted):  # a rollout that the budget cuts
            model.learn(oracle.remaining)
        record = oracle.record
    print(f"horizon {horizon}: {len(record):,} queries, the store knew {known[-1]:,} of them")
    return model, record


def fooling_rate(mu: np.ndarray) -> str:
    """Measure mu on seeds that training never used."""
    with Oracle(ENV_ID, budget=len(mu), seed=0, stream="test") as test:
        return str(attack_fooling_rate(test(mu), test.threshold))


def main() -> None:
    """Train a sampler and a searcher; measure the one's samples and what both found."""
    application = sada_gym.make_application(ENV_ID)
    model, record = train(horizon=1)
    mu = sample_policy(model, dimension=2, n=250, seed=0)
    region = application.fooling_region(mu)  # -1 outside
    print(f"before: {fooling_rate(record.mu[:ENVS])}")
    print(f"after:  {fooling_rate(mu)}")
    print("samples in each of the four regions:", [int((region == i).sum()) for i in range(4)])

    _, searched = train(horizon=8)
    truth = application.sample_fooling_set(1_000, np.random.default_rng(0))
    threshold, checkpoints = application.fooling_threshold, [BUDGET // 16, BUDGET // 4, BUDGET]
    print("share of the fooling set that the queries have reached:")
    for what, asked in (("horizon 1", record), ("horizon 8", searched)):
        curve = anytime(asked.mu, asked.score, threshold, truth, checkpoints)
        points = ", ".join(f"{p.coverage:.0%} after {p.queries:,}" for p in curve)
        print(f"{what}: {points}")


if __name__ == "__main__":
    main()
