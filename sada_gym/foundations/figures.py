"""Figures as people read them: numbers and shares."""

from __future__ import annotations

_LARGE = 1e12


def number(value: float) -> str:
    """Write a number with three digits and a real minus sign."""
    text = f"{value:,.0f}" if 1000 <= abs(value) < _LARGE else f"{value:.3g}"
    return text.replace("-", "\N{MINUS SIGN}")


def percent(share: float) -> str:
    """Write a share as people read it: `31 %`."""
    percent = 100.0 * share
    if percent == 0.0:
        return "0 %"
    if percent < 0.1:
        return "under 0.1 %"
    # what is not all of them never reads as 100 %
    shown = min(percent, 99.0) if share < 1.0 else percent
    return f"{shown:.1f} %" if percent < 1.0 else f"{shown:.0f} %"


def tenths(share: float) -> str:
    """Write a share to a tenth of a per cent: `31.4 %`."""
    return f"{100.0 * share:.1f} %"
