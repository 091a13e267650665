"""Help on one screen: the options that most people use, a sentence each; ``--help-all`` shows the rest."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cyclopts.help import DefaultFormatter

if TYPE_CHECKING:
    from cyclopts.help import HelpPanel
    from rich.console import Console, ConsoleOptions

#: Commands whose help is cut, because of many options, and options that it shows.
COMMANDS = ("segment", "refine", "view", "movie", "batch", "track")
SHOWN = {
    "--answer",
    "--case",
    "--frame",
    "--inside",
    "--input",
    "--labels",
    "--objects",
    "--outside",
    "--output",
    "--overwrite",
    "--preset",
    "--resume",
    "--size",
    "--smoothness",
    "--start",
    "--to-edges",
    "--track",
}


class ShortHelp(DefaultFormatter):
    """Draws the arguments of a panel and its options that are `SHOWN`, each with the first sentence of its text."""

    def __call__(self, console: Console, options: ConsoleOptions, panel: HelpPanel) -> None:
        """Draw a panel, or nothing where none of its entries is shown."""
        entries = []
        for entry in panel.entries:
            if entry.positional_label is not None or SHOWN.intersection(entry.positive_names):
                entries.append(entry.copy(description=_first_sentence(entry.description)))
        if entries:
            super().__call__(console, options, panel.copy(entries=entries))


def _first_sentence(description: object) -> object:
    """The text up to its first full stop."""
    text = getattr(getattr(description, "primary_renderable", description), "plain", "")
    return text.partition(". ")[0].rstrip(".")
