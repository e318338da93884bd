"""Where samples are proposed: along the ridges of modes, around them, and as earlier ones lie."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import numpy as np
import numpy.typing as npt
from scipy.special import gammaln, softmax

from thigmo.field.fit import Mode
from thigmo.field.hypotheses import BASE, FOLD, RADIUS, UNSIGNED
from thigmo.field.readings import Floats
from thigmo.field.search import RADII

_PROPOSED = 14.0  # cost beyond which a node proposes no samples
_DOF, WIDER = 6, 1.3  # of the proposals
_WIDEST = 6.0  # standard deviations over which an unknown direction is proposed
_DRAWS, _LEAST_DRAWS = 8000, 60  # of a bell, for its part where nothing unsigned is negative
_TEMPER = 0.35  # exponent of the modes' weights among the proposals
_TEMPERED = 25.0  # effective samples from which later rounds learn
_LEAST_TEMPER = 1e-3  # power of the weights: some samples are impossible, whatever the power
# Of what is learnt, over the samples' covariance: wide, since samples near a mode agree before
# those of a wide tail are found; and once these have been sought, no wider than helps to agree.
SPREAD, SETTLED_SPREAD = 3.0, 1.5
_LEAST_SHARE = 0.02  # of a chain's weight, with less of which nothing is learnt of it
_KEPT = np.array([0, 1, 3, 4, 5, 6])  # unknowns other than the radius
_UNFOLDED = 0.25  # of the proposals, against those that hold to a mode's fold
_SIGNS = np.array(list(product((1.0, -1.0), repeat=len(UNSIGNED))))


class Mixture:
    """t-distributions around points, each lying along a ridge: unknowns move with the radius."""

    def __init__(
        self, centers: Floats, slopes: Floats, factors: Floats, share: Floats, step: float
    ) -> None:
        """Of n points: `slopes` (n, 6) of the other unknowns over the radius's logarithm, of which
        one sigma is `step`; `factors` (n, 6, 6) of their covariance; `share` (n,) of sum one.
        """
        self._centers, self._slopes, self._factors = centers, slopes, factors
        self._share, self._step = share, step
        self._inverses = np.linalg.inv(factors)
        self._volumes = np.linalg.slogdet(factors)[1]
        d = _KEPT.size
        self._norm = float(
            gammaln((_DOF + d) / 2) - gammaln(_DOF / 2) - 0.5 * d * np.log(_DOF * np.pi)
            - np.log(step * np.sqrt(2 * np.pi))
        )  # fmt: skip

    def draw(self, rng: np.random.Generator) -> Floats:
        """Unknowns."""
        n = int(rng.choice(self._share.size, p=self._share))
        off = self._step * rng.standard_normal()
        wide = np.sqrt(_DOF / rng.chisquare(_DOF))
        q = self._centers[n].copy()
        q[RADIUS] += off
        q[_KEPT] += self._slopes[n] * off
        q[_KEPT] += wide * self._factors[n] @ rng.standard_normal(_KEPT.size)
        q[list(UNSIGNED)] = np.abs(q[list(UNSIGNED)])
        drawn: Floats = q
        return drawn

    def nearest(self, q: Floats) -> npt.NDArray[np.intp]:
        """(k,) the points around which unknowns (k, 7) most probably lie."""
        nearest: npt.NDArray[np.intp] = np.argmax(self._logs(q), axis=1)
        return nearest

    def log_density(self, q: Floats) -> Floats:
        """(k,) logarithm of the density at unknowns (k, 7), mirrored ones included."""
        mirrored = q * _mirrors(q.shape[1])[:, None]
        logs = self._logs(mirrored.reshape(-1, q.shape[1])).reshape(*mirrored.shape[:2], -1)
        density: Floats = np.logaddexp.reduce(logs, axis=(0, 2)) + self._norm
        return density

    def _logs(self, q: Floats) -> Floats:
        off = q[:, None, RADIUS] - self._centers[:, RADIUS]
        away = q[:, None, _KEPT] - self._centers[:, _KEPT] - self._slopes * off[..., None]
        z = np.einsum("nij,qnj->qni", self._inverses, away)
        bells = -0.5 * (_DOF + _KEPT.size) * np.log1p(np.sum(z**2, axis=-1) / _DOF)
        share = np.log(np.maximum(self._share, 1e-300))
        logs: Floats = share + bells - self._volumes - 0.5 * (off / self._step) ** 2
        return logs


class Bell:
    """A t-distribution of unknowns."""

    def __init__(self, center: Floats, covariance: Floats) -> None:
        self._center = center
        self._factor = np.linalg.cholesky(covariance)
        self._inverse = np.linalg.inv(self._factor)
        d = center.size
        self._norm = float(
            gammaln((_DOF + d) / 2) - gammaln(_DOF / 2) - 0.5 * d * np.log(_DOF * np.pi)
            - np.log(np.diag(self._factor)).sum()
        )  # fmt: skip

    def draw(self, rng: np.random.Generator) -> Floats:
        """Unknowns."""
        wide = np.sqrt(_DOF / rng.chisquare(_DOF))
        q: Floats = self._center + wide * self._factor @ rng.standard_normal(self._center.size)
        q[list(UNSIGNED)] = np.abs(q[list(UNSIGNED)])
        return q

    def log_density(self, q: Floats) -> Floats:
        """(k,) logarithm of the density at unknowns (k, d), mirrored ones included."""
        d = self._center.size
        z = (q * _mirrors(d)[:, None] - self._center) @ self._inverse.T
        logs = -0.5 * (_DOF + d) * np.log1p(np.sum(z**2, axis=2) / _DOF)
        density: Floats = np.logaddexp.reduce(logs, axis=0) + self._norm
        return density


class Bells:
    """Bells around modes."""

    def __init__(self, bells: list[Bell], share: Floats) -> None:
        self._bells, self._share = bells, share

    def draw(self, rng: np.random.Generator) -> Floats:
        """Unknowns."""
        return self._bells[int(rng.choice(self._share.size, p=self._share))].draw(rng)

    def nearest(self, q: Floats) -> npt.NDArray[np.intp]:
        """(k,) the bells in which unknowns (k, d) most probably lie."""
        nearest: npt.NDArray[np.intp] = np.argmax(self._logs(q), axis=0)
        return nearest

    def log_density(self, q: Floats) -> Floats:
        """(k,) logarithm of the density at unknowns (k, d), mirrored ones included."""
        density: Floats = np.logaddexp.reduce(self._logs(q), axis=0)
        return density

    def _logs(self, q: Floats) -> Floats:
        logs = [bell.log_density(q) for bell in self._bells]
        return np.array(logs) + np.log(self._share)[:, None]


Proposal = Mixture | Bells | Bell


def _mirrors(unknowns: int) -> Floats:
    """(8, unknowns) signs under which samples mean the same."""
    mirrors = np.ones((len(_SIGNS), unknowns))
    mirrors[:, list(UNSIGNED)] = _SIGNS
    return mirrors


def learnt_bells(
    q: Floats, logs: Floats, chain: npt.NDArray[np.intp], spread: float
) -> tuple[list[Bell], Floats]:
    """What samples of each chain are spread as, and the chains' shares of the weight.

    `logs`: (k,) logarithms of the samples' weights; `spread`: of the bells over the samples'
    covariance.
    """
    # Tempered until enough samples share the weight to give a covariance. A weight may be below
    # what a number can hold, so its logarithm is tempered.
    temper, weight = 1.0, softmax(logs)
    while temper > _LEAST_TEMPER and _TEMPERED * np.sum(weight**2) > 1:
        temper *= 0.8
        weight = softmax(temper * logs)
    bells, shares = [], []
    for number in np.unique(chain):
        on = (chain == number) & (weight > 0.0)
        share = weight[on].sum()
        part = weight[on] / share if share else weight[on]
        if share < _LEAST_SHARE or np.sum(part**2) > 1 / q.shape[1]:
            continue
        center = part @ q[on]
        off = q[on] - center
        covariance = spread * (part[:, None] * off).T @ off
        bells.append(Bell(center, covariance + 1e-9 * np.diag(np.diag(covariance))))
        shares.append(share)
    return bells, np.array(shares) / max(sum(shares), 1e-300)


def bounded(center: Floats, precision: Floats) -> tuple[Floats, Floats, float]:
    """Mean, covariance and share of that part of a bell where nothing unsigned is negative.

    Along an even direction the bell is `_WIDEST` wide. Base, yield and friction explain much the
    same, so a bell that reaches far below 0 in one and above in another has a small such part.
    """
    d = center.size
    w, v = np.linalg.eigh(precision)
    wide = v * np.minimum(1 / np.sqrt(np.maximum(w, 1e-9)), _WIDEST)
    draws = center + np.random.default_rng(d).standard_normal((_DRAWS, d)) @ wide.T
    inside = draws[(draws[:, list(UNSIGNED)] >= 0.0).all(axis=1)]
    share = len(inside) / _DRAWS
    if len(inside) < _LEAST_DRAWS:
        inside = draws
        inside[:, list(UNSIGNED)] = np.abs(inside[:, list(UNSIGNED)])
    covariance: Floats = np.cov(inside, rowvar=False)
    return inside.mean(axis=0), covariance, max(share, 1 / _DRAWS)


def _unfolded(mode: Mode) -> Floats:
    """A mode's precision as if readings said nothing of the fold's moment and the base.

    A base that folds under a moment as stated may also turn before it folds under a higher one,
    where the readings have no such curvature as at the mode.
    """
    precision = mode.precision.copy()
    for n in (mode.q.size + FOLD, mode.q.size + BASE):
        precision[n] = precision[:, n] = 0.0
        precision[n, n] = mode.prior_precision[n]
    return precision


def around(
    chains: Sequence[Sequence[Mode]],
) -> tuple[Bells, list[Mode], npt.NDArray[np.intp]]:
    """Proposals around modes, the modes, and the numbers of their chains."""
    numbered = [(n, mode) for n, chain in enumerate(chains) for mode in chain]
    best = min(mode.cost for _, mode in numbered)
    numbered = [(n, mode) for n, mode in numbered if mode.cost < best + _PROPOSED]
    near = [mode for _, mode in numbered]
    share = np.exp([-_TEMPER * (mode.cost - best) for mode in near])
    bells = []
    for mode in near:
        center, covariance, _ = bounded(mode.q, mode.precision)
        bells.append(Bell(center, WIDER**2 * covariance))
    numbers = np.array([n for n, _ in numbered], dtype=np.intp)
    return Bells(bells, share / share.sum()), near, numbers


def along_ridges(
    chains: Sequence[Sequence[Mode]],
) -> tuple[Mixture, list[Mode], npt.NDArray[np.intp]]:
    """Proposals around the nodes of ridges, the nodes, and the numbers of their chains."""
    best = min(mode.cost for chain in chains for mode in chain)
    modes: list[Mode] = []
    centers, slopes, factors = [], [], []
    numbers = []
    for number, chain in enumerate(chains):
        q = np.array([mode.q for mode in chain])
        many = len(chain) > 1
        slope = np.gradient(q[:, _KEPT], q[:, RADIUS], axis=0) if many else [np.zeros(_KEPT.size)]
        for mode, along in zip(chain, slope, strict=True):
            if mode.cost < best + _PROPOSED:
                for precision in (mode.precision, _unfolded(mode)):
                    kept = precision[np.ix_(_KEPT, _KEPT)]
                    center = mode.q.copy()
                    center[_KEPT], covariance, _ = bounded(mode.q[_KEPT], kept)
                    modes.append(mode)
                    numbers.append(number)
                    centers.append(center)
                    slopes.append(along)
                    factors.append(WIDER * np.linalg.cholesky(covariance))
    share = np.exp([-_TEMPER * (mode.cost - best) for mode in modes])
    share[1::2] *= _UNFOLDED
    step = 0.75 * (RADII[1] - RADII[0])
    mixture = Mixture(
        np.array(centers), np.array(slopes), np.array(factors), share / share.sum(), step
    )
    return mixture, modes, np.array(numbers, dtype=np.intp)
