"""The oracle under the name that users import: `from sada_gym.oracle import Oracle`."""

from sada_gym.errors import BudgetExhausted
from sada_gym.evaluation.oracle import Oracle
from sada_gym.evaluations import Evaluations, Stream, evaluation_seeds

__all__ = ["BudgetExhausted", "Evaluations", "Oracle", "Stream", "evaluation_seeds"]
