"""The seeded model: a force field learned from inside and outside clicks."""

from accelsurf.energies.seeded.model import SeededModel, seeded_model
from accelsurf.energies.seeded.proposal import Proposal
from accelsurf.energies.seeded.sureness import Sureness

__all__ = ["Proposal", "SeededModel", "Sureness", "seeded_model"]
