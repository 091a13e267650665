"""Says what is missing when pytest-benchmark is not there."""

from __future__ import annotations

import importlib.util

import pytest


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    if importlib.util.find_spec("pytest_benchmark") is None:
        for item in items:
            item.add_marker(
                pytest.mark.skip(
                    reason="pytest-benchmark is not installed (pip install pytest-benchmark)"
                )
            )
