"""The robot and the ground in MuJoCo."""
