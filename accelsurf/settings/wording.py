"""Words of messages and of units: values cut to a readable length, names that may have been meant, lengths, times."""

from __future__ import annotations

import difflib
import json
import re
from collections.abc import Iterable
from typing import Any

#: Largest number of characters of a value that a message repeats.
MAX_SHOWN = 60
_MICRO = (
    "um",
    "\u00b5m",
    "\u03bcm",
    "micron",
    "microns",
    "micrometer",
    "micrometers",
    "micrometre",
    "micrometres",
)
#: Millimetres of the units of length, by every name that files give them.
_MM_PER_UNIT = {
    **dict.fromkeys(("pm", "picometer"), 1e-9),
    **dict.fromkeys(("\u00e5", "angstrom"), 1e-7),
    **dict.fromkeys(("nm", "nanometer", "nanometers", "nanometre", "nanometres"), 1e-6),
    **dict.fromkeys(_MICRO, 1e-3),
    **dict.fromkeys(("mm", "millimeter", "millimeters", "millimetre", "millimetres"), 1.0),
    **dict.fromkeys(("cm", "centimeter", "centimeters", "centimetre", "centimetres"), 10.0),
    **dict.fromkeys(("dm", "decimeter"), 100.0),
    **dict.fromkeys(("m", "meter", "meters", "metre", "metres"), 1e3),
    "km": 1e6,
    **dict.fromkeys(("inch", "inches", "in", '"'), 25.4),
    **dict.fromkeys(("ft", "foot"), 304.8),
    "yard": 914.4,
    "thou": 0.0254,
    "li": 25.4 / 12,
    "pt": 25.4 / 72,
}
#: Seconds of the units of time.
_SECONDS_PER_UNIT = {
    **dict.fromkeys(("ns", "nanosecond"), 1e-9),
    **dict.fromkeys(("\u00b5s", "\u03bcs", "us", "microsecond"), 1e-6),
    **dict.fromkeys(("ms", "msec", "millisecond"), 1e-3),
    **dict.fromkeys(("s", "sec", "second", "seconds"), 1.0),
    **dict.fromkeys(("min", "minute"), 60.0),
    **dict.fromkeys(("h", "hour"), 3600.0),
    **dict.fromkeys(("d", "day"), 86400.0),
}
_ESCAPE = re.compile(r"\\u([0-9a-fA-F]{4})")
#: How many of a unit in which sizes are shown are a mm.
_IN_MM = {"nm": 1e6, "um": 1e3, "mm": 1.0}


def shown(value: Any) -> str:
    r"""Return a value as a message repeats it: on one line, of `MAX_SHOWN` characters at most.

    Characters that a terminal does not print are written as escapes.

    Examples
    --------
    >>> shown("gradent"), shown(""), shown(None), shown(chr(27)), len(shown("x" * 1000))
    ('gradent', '""', 'null', '\\x1b', 60)
    """
    text = value if isinstance(value, str) and value else json.dumps(value, default=str)
    # Of a long text no more is looked at than can be shown.
    text = escaped(text[: MAX_SHOWN + 1])
    return text if len(text) <= MAX_SHOWN else text[: MAX_SHOWN - 1] + "…"


def escaped(text: str) -> str:
    r"""A text with the characters that a terminal does not print written as escapes.

    Examples
    --------
    >>> escaped("a" + chr(27))
    'a\\x1b'
    """
    return "".join(
        c if c.isprintable() else c.encode("unicode_escape").decode("ascii") for c in text
    )


def nearest(given: Any, names: Iterable[str]) -> str:
    """Return the name nearest to the given one; empty if none is like it.

    Examples
    --------
    >>> nearest("Gradent", ["gradient", "sobolev"]), nearest("x", ["gradient", "sobolev"])
    ('gradient', '')
    """
    known = list(names)
    if not isinstance(given, str) or len(given) > MAX_SHOWN:
        return ""
    wanted = given.strip().lower().replace("_", "-")
    by_key = {name.lower().replace("_", "-"): name for name in known}
    close = difflib.get_close_matches(wanted, by_key, n=1, cutoff=0.6)
    return by_key[close[0]] if close else ""


def did_you_mean(given: Any, names: Iterable[str]) -> str:
    """Return a question to put before a hint, with a blank behind it; empty if no name is like the given one.

    Examples
    --------
    >>> did_you_mean("gradent", ["gradient", "sobolev"])
    'did you mean gradient? '
    """
    name = nearest(given, names)
    return f"did you mean {name}? " if name else ""


def mm_of(unit: str) -> float:
    r"""Return the millimetres of a unit of length; 0 for other texts, as pixel.

    Examples
    --------
    >>> mm_of("micron"), mm_of("\\u00B5m"), mm_of("inch"), mm_of("pixel"), mm_of("Mm")
    (0.001, 0.001, 25.4, 0.0, 0.0)
    """
    name = _ESCAPE.sub(lambda found: chr(int(found.group(1), 16)), unit).strip()
    if len(name) == 2 and name[0] in "YZEPTGM" and name[1] == "m":  # megametres, and more
        return 0.0
    return _MM_PER_UNIT.get(name.lower(), 0.0)


def unit_name(mm: float) -> str:
    """The unit in which lengths are shown, by the millimetres of the unit of a file.

    Examples
    --------
    >>> unit_name(1e-3), unit_name(10.0), unit_name(1e-7)
    ('um', 'mm', 'nm')
    """
    return "nm" if mm < 1e-4 else "um" if mm < 0.1 else "mm"


def seconds_of(unit: str) -> float:
    """Seconds of a unit of time; 0 for other texts. Abbreviations are as they are written: Ms is a million seconds.

    Examples
    --------
    >>> seconds_of("msec"), seconds_of("Minute"), seconds_of("Ms")
    (0.001, 60.0, 0.0)
    """
    return _SECONDS_PER_UNIT.get(unit if len(unit) < 4 else unit.lower(), 0.0)


def in_unit(mm: float, unit: str, power: int = 1) -> float:
    """Return a length, an area (power 2) or a volume (power 3) as a number of a unit.

    Examples
    --------
    >>> in_unit(0.25, "um"), in_unit(0.25, "mm", 3)
    (250.0, 0.25)
    """
    return mm * _IN_MM[unit] ** power


def size_text(mm: float, unit: str = "mm", power: int = 1, digits: int = 4) -> str:
    """Return a length, an area (power 2) or a volume (power 3) in the unit of the file that it was measured in.

    Parameters
    ----------
    mm : float
        In mm, mm2 or mm3.
    unit : {"mm", "um", "nm"}
    power : int
    digits : int
        How many, at most: the intervals around measures are a thousandth of them wide at best, so four are known.

    Examples
    --------
    >>> size_text(0.0123456789, "um"), size_text(1.12084e-5, "um", 3), size_text(34161.94, power=2)
    ('12.35 um', '11210 um3', '34160 mm2')
    """
    number = float(f"{in_unit(mm, unit, power):.{digits}g}")
    text = f"{number:.12g}" if abs(number) < 1e7 else f"{number:.{digits}g}"
    return f"{text} {unit}{power if power > 1 else ''}"


def rounded_text(value: float, digits: int = 4) -> str:
    """Return a number rounded to ``digits`` significant digits, without an exponent.

    Examples
    --------
    >>> rounded_text(38201.47), rounded_text(0.0123456)
    ('38200', '0.01235')
    """
    return f"{float(f'{value:.{digits}g}'):.15g}"


def voxel_text(spacing_mm: Iterable[float], unit: str = "mm") -> str:
    """Return the size of a voxel in the unit of the file.

    Examples
    --------
    >>> voxel_text((0.0002, 0.0002, 0.001), "um")
    '0.2 x 0.2 x 1 um'
    """
    return " x ".join(f"{size * _IN_MM[unit]:.4g}" for size in spacing_mm) + f" {unit}"


def size_setting(mm3: float) -> str:
    """Return a volume as the setting ``size`` takes it, without an exponent: in the unit that has four digits of it.

    Examples
    --------
    >>> size_setting(1234.5), size_setting(4.2e-7), size_setting(4.2e-13)
    ('1234.5000mm3', '420.0000um3', '420000.0000nm3')
    """
    unit = next((unit for unit in ("mm", "um") if in_unit(mm3, unit, 3) >= 1.0), "nm")
    return f"{in_unit(mm3, unit, 3):.4f}{unit}3"


def volume_text(mm3: float, unit: str = "mm") -> str:
    """Return a volume in the unit that people use for its size, or in that of an image of a microscope.

    Examples
    --------
    >>> volume_text(1.5234e6), volume_text(12.3), volume_text(4.2e-7), volume_text(0.25, "um")
    ('1523 ml', '12.3 mm3', '420 um3', '2.5e+08 um3')
    """
    if unit != "mm":
        return size_text(mm3, unit, 3)
    if mm3 >= 1000:
        return f"{mm3 / 1000:.4g} ml" if mm3 < 1e7 else f"{mm3 / 1e6:.4g} l"
    return f"{mm3:.4g} mm3" if mm3 >= 0.01 or mm3 <= 0 else f"{mm3 * 1e9:.4g} um3"
