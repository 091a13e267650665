"""Fonts of the pictures: one that is the same everywhere, and those that are installed for further scripts."""

from __future__ import annotations

import functools
import importlib.util
import sys
from pathlib import Path

from PIL import ImageFont

#: What files of fonts with other scripts than Latin, Greek and Cyrillic begin with, and where systems have them.
_FURTHER = (
    "NotoSansCJK", "wqy-microhei", "wqy-zenhei", "DroidSansFallback", "ipag", "Hiragino", "PingFang", "Arial Unicode",
    "msyh", "msgothic", "malgun", "simhei", "NotoSansDevanagari", "NotoSansArabic", "NotoSansThai",
)
_FOLDERS = {
    "darwin": ("/System/Library/Fonts", "/Library/Fonts"),
    "win32": ("C:/Windows/Fonts",),
}
_SUFFIXES = (".ttf", ".ttc", ".otf")
#: Stands for a character that no font has: a white square.
MISSING = "\u25a1"
#: No font has this one: what is drawn for it is what is drawn for every missing character.
_NO_CHARACTER = "\uffff"

Font = ImageFont.FreeTypeFont


@functools.cache
def plain_font(size: int, bold: bool = False) -> Font:
    """DejaVu Sans, ``size`` pixels high, whose file comes with matplotlib; matplotlib itself is not imported."""
    found = importlib.util.find_spec("matplotlib")
    if found is None or found.origin is None:
        raise ImportError("matplotlib, which accelsurf requires, is not installed: its fonts are missing")
    name = "DejaVuSans-Bold.ttf" if bold else "DejaVuSans.ttf"
    path = Path(found.origin).parent / "mpl-data" / "fonts" / "ttf" / name
    return ImageFont.truetype(str(path), size, layout_engine=ImageFont.Layout.BASIC)


@functools.cache
def _further_files() -> tuple[str, ...]:
    """Files of the fonts with further scripts that are installed."""
    files: list[str] = []
    for folder in map(Path, _FOLDERS.get(sys.platform, ("/usr/share/fonts", "/usr/local/share/fonts"))):
        files += [str(path) for path in sorted(folder.rglob("*")) if path.suffix.lower() in _SUFFIXES]
    return tuple(file for start in _FURTHER for file in files if Path(file).name.startswith(start))


@functools.cache
def _further_fonts(size: int) -> tuple[Font, ...]:
    fonts = []
    for file in _further_files():
        try:
            fonts.append(ImageFont.truetype(file, size, layout_engine=ImageFont.Layout.BASIC))
        except OSError:  # a damaged file of the system is no reason to draw nothing
            continue
    return tuple(fonts)


def _has(font: Font, one: str) -> bool:
    """Whether a font has a character: what it draws for it is not what it draws for every missing one."""
    if one.isspace():
        return True
    drawn, missing = font.getmask(one), font.getmask(_NO_CHARACTER)
    return drawn.size != missing.size or bytes(drawn) != bytes(missing)


def runs_of(text: str, size: int, bold: bool = False) -> list[tuple[str, Font]]:
    """Divide one line of text into parts of one font each, with `MISSING` for characters that no font has.

    Examples
    --------
    >>> [part for part, _ in runs_of("a$b" + chr(7), 12)] == ["a$b" + chr(0x25A1)]
    True
    """
    plain = plain_font(size, bold)
    if text.isascii() and text.isprintable():
        return [(text, plain)]
    runs: list[tuple[str, Font]] = []
    for one in text:
        usable = one.isprintable() and not "\ud800" <= one <= "\udfff"
        fonts = (plain, *(() if one.isascii() or _has(plain, one) else _further_fonts(size))) if usable else ()
        font = next((font for font in fonts if _has(font, one)), None)
        one, font = (MISSING, plain) if font is None else (one, font)
        if runs and runs[-1][1] is font:
            runs[-1] = (runs[-1][0] + one, font)
        else:
            runs.append((one, font))
    return runs
