"""The contract of `own_adversary.Neighbourhood`: pytest examples/test_own_adversary.py."""

from own_adversary import Neighbourhood

from sada_gym.testing import AdversaryContract


class TestNeighbourhood(AdversaryContract):
    """It keeps what every adversary keeps."""

    def make(self, dimension: int, seed: int) -> Neighbourhood:
        """Make the adversary, cheap to train."""
        return Neighbourhood(dimension, seed=seed)
