"""A TensorBoard log of an adversary's training, where tensorboard is installed."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from sada_gym.errors import MissingExtra, install_line
from sada_gym.foundations.drawing import own_style
from sada_gym.foundations.files import file_errors
from sada_gym.parameters import Mu


class TrainingLog:
    """Writes losses, and histograms and a scatter plot of samples; it needs tensorboard."""

    def __init__(self, folder: str | Path) -> None:
        self._prefix = ""
        try:
            from torch.utils.tensorboard import SummaryWriter
        except ImportError as error:
            raise MissingExtra(
                "Expected tensorboard for log_dir, but it is not installed. "
                f"{install_line('track')}"
            ) from error
        with file_errors("write the log to", Path(folder)):
            self._writer: Any = SummaryWriter(str(folder))  # type: ignore[no-untyped-call, unused-ignore]

    def start(self, part: str) -> None:
        """Write all later entries under a name, such as that of a stage of boosting."""
        self._prefix = f"{part}/"

    def scalars(self, step: int, values: Mapping[str, float]) -> None:
        """Write one value for each name."""
        for name, value in values.items():
            self._writer.add_scalar(self._prefix + name, value, step)

    @own_style()
    def samples(self, step: int, mu: Mu) -> None:
        """Write mu, (n, d), as a histogram a dimension and a scatter plot of the first two."""
        from matplotlib.figure import Figure

        for i, column in enumerate(mu.T):
            self._writer.add_histogram(f"{self._prefix}mu/{i}", column, step)
        figure = Figure(figsize=(4, 4))
        axes = figure.add_subplot(
            xlim=(-1.02, 1.02), ylim=(-1.02, 1.02), xlabel="mu 0", ylabel="mu 1"
        )
        axes.scatter(mu[:, 0], mu[:, min(1, mu.shape[1] - 1)], s=3)
        self._writer.add_figure(f"{self._prefix}samples", figure, step)

    def close(self) -> None:
        """Flush and close the files."""
        self._writer.close()
