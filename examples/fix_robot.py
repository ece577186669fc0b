"""Find the conditions in which the shipped robot fails, and train it on there.

    python examples/fix_robot.py

It takes some minutes. The episodes go on in lockstep, which is faster than `FailureCurriculum` many
times.
"""

from stable_baselines3.common.vec_env import VecMonitor, VecNormalize

from sada_gym import agents, attack, curriculum_vec_env
from sada_gym.envs.robot.agent.network import new_model
from sada_gym.foundations.determinism import one_thread

TRACK = "SADA-Robot-v0"
BUDGET = 1_000
TRAINING_STEPS = 200_000
FOLDER = "runs/fix-robot"


def main() -> None:
    """Attack the shipped `ppo`, train it on, attack it again."""
    given = {"env_kwargs": {"agent": "ppo"}, "out": f"{FOLDER}/before"}
    first = attack(TRACK, "level-set", budget=BUDGET, resume=True, **given)

    env = curriculum_vec_env(TRACK, first.folder, num_envs=16)
    with one_thread():
        robot = new_model(
            0,
            VecNormalize(VecMonitor(env), norm_obs=False, gamma=0.98),
            n_steps=64,
            batch_size=256,
            learning_rate=2e-4,
            gamma=0.98,
            target_kl=0.03,
        )
        robot.policy.load_state_dict(agents.load("ppo", "SADA-Robot").policy.state_dict())
        robot.learn(TRAINING_STEPS)

    given = {"env_kwargs": {"agent": robot}, "out": f"{FOLDER}/after"}
    second = attack(TRACK, "level-set", budget=BUDGET, resume=True, **given)
    for name, run in (("ppo", first), ("the fixed robot", second)):
        print(f"{run.result.afr:.0%} of the new worlds fool {name}")


if __name__ == "__main__":
    main()
