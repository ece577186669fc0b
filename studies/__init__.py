"""Studies behind the documentation's figures, one module each: `python -m studies.NAME`."""

import sada_gym  # noqa: F401  # first: it chooses kernels before NumPy loads
