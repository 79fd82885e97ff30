"""Crystals that would have dissolved completely, but which moments still count.

All crystals grow and shrink by the same length l(t), so one of size L at a time s has the size
L + l(t) - l(s) later. Once that is below 0 it is gone. In the moments it stays, of a size below 0,
and grows again with the others.
"""

import numpy as np

from .kinetics import Rates

SURFACE = 0.01  # of all crystals' surface that may belong to some which are gone
MAXIMUM = 1000  # points in time
REMEDY = 'by moments none disappears; use method = "finite-volumes"'


def disappeared(track: dict[str, np.ndarray], rates: Rates, nuclei_size: float) -> str:
    """Crystals that dissolve along a `track` by moments with its `rates`, as text; "" if few do.

    Of the crystals at the start those are the smallest below which two in a hundred lie, if
    their sizes are lognormal with the track's first moments.
    """
    time, growth = track["time"], np.asarray(rates.growth)
    born = np.append(0.0, _steps(np.asarray(rates.nucleation), time))
    length = np.append(0.0, np.cumsum(_steps(growth, time)))
    smallest, shrunk = _smallest(*(track[f"mu{k}"][0] for k in range(3))), -length.min()
    if 0 < smallest <= shrunk:
        return (
            f"crystals shrink by {1e6 * shrunk:.3g} um, and the smallest at the start have "
            f"{1e6 * smallest:.3g} um: {REMEDY}"
        )
    # Nuclei of an interval count as born at its end.
    selected = np.unique(np.linspace(0, len(time) - 1, MAXIMUM).astype(int))
    born = np.diff(np.cumsum(born)[selected], prepend=0.0)
    size = (
        nuclei_size + length[selected][:, None] - length[selected]
    )  # of those born then, at every time
    gone = np.minimum.accumulate(np.tril(size) + np.triu(np.full_like(size, np.inf), 1), 0) < 0
    surface = np.where(gone, size**2, 0.0) @ born
    complete = track["mu2"][selected]
    share = np.max(surface / np.where(complete > 0, complete, np.inf))
    if share > SURFACE:
        return f"crystals that have dissolved hold {share:.2g} of the surface: {REMEDY}"
    return ""


def _steps(rate: np.ndarray, time: np.ndarray) -> np.ndarray:
    return np.diff(time) * (rate[1:] + rate[:-1]) / 2


def _smallest(mu0: float, mu1: float, mu2: float) -> float:
    """exp(m - 2 s) of a lognormal distribution with these moments; 0 without crystals."""
    if mu0 <= 0 or mu1 <= 0:
        return 0.0
    spread = np.sqrt(np.log(max(mu2 * mu0 / mu1**2, 1.0)))
    return float(mu1 / mu0 * np.exp(-(spread**2) / 2 - 2 * spread))
