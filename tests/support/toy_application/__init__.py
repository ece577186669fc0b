"""An application as a contributor adds it; see `tests/envs/test_new_application.py`."""
