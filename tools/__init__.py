"""Tools that draw the documentation's pictures and check it: `python -m tools.NAME`."""

import sada_gym  # noqa: F401  # first: it chooses kernels before NumPy loads
