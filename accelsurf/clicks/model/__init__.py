"""The model of clicks: from inside and outside clicks to a score map F and the object that it shows."""

from accelsurf.clicks.model.answers import Answer
from accelsurf.clicks.model.model import ClickModel, click_model
from accelsurf.clicks.model.windows import Scene

__all__ = ["Answer", "ClickModel", "Scene", "click_model"]
