"""Options with which each adversary trains in a moment, where what it learns does not matter."""

QUICK = {
    "bbgan": {"steps": 5, "batch": 16, "generator": (16,), "discriminator": (16,)},
    "bbgan-boost": {"steps": 5, "batch": 16, "generator": (16,), "discriminator": (16,)},
    "bayesian": {"candidates": 512, "components": (1, 2)},
    "cross-entropy": {"stages": 1},
    "trees": {"trees": 20},
    "level-set": {"rounds": 1, "models": ["trees"]},
    "ppo": {"hidden": (16,)},
    "sac": {"hidden": (16,), "updates": 0.1},
    "td3": {"hidden": (16,), "updates": 0.1},
}
