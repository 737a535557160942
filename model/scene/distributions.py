"""Laws from which the fractures of a random set are drawn: lengths, angles and apertures.

Each draws with a NumPy generator that is handed to it, so that a seed says it all. Lengths know
their mean and their length-biased law too, which a window needs that long fractures meet more
often than short ones.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from demflow.model.parameters import SceneError, check_fields, parameter

__all__ = [
    "Aperture",
    "Exponential",
    "Length",
    "LengthPower",
    "LogNormal",
    "PowerLaw",
    "Uniform",
    "VonMises",
]

Array = np.ndarray


@dataclass(frozen=True, slots=True)
class PowerLaw:
    """Lengths with density ∝ ℓ^(−a) between a least and a largest one."""

    exponent: float = parameter(key="power_law", help="a, the density falls as length^(-a)")
    least: float = parameter("m", key="from", above=0, help="least length")
    largest: float = parameter("m", key="to", above=0, help="largest length")

    def __post_init__(self) -> None:
        check_fields(self)
        if self.largest <= self.least:
            raise SceneError([("to", "the largest length must be above the least")])

    @property
    def mean(self) -> float:
        """Mean length, m: ∫ ℓ^(1−a) dℓ / ∫ ℓ^(−a) dℓ."""
        return self.least * self._integral(1.0 - self.exponent) / self._integral(-self.exponent)

    def draw(self, rng: np.random.Generator, count: int) -> Array:
        """Lengths (count,) in m, from the inverse of the cumulative density."""
        u, span = rng.random(count), math.log(self.largest / self.least)
        power = (1.0 - self.exponent) * span
        if power == 0.0:
            return self.least * np.exp(u * span)
        return self.least * np.exp(np.log1p(u * math.expm1(power)) * span / power)

    def biased(self, rng: np.random.Generator, count: int) -> Array:
        """Lengths (count,) in m with density ∝ ℓ times this law's."""
        return replace(self, exponent=self.exponent - 1.0).draw(rng, count)

    def _integral(self, power: float) -> float:
        """∫ x^power dx from 1 to largest / least."""
        span = math.log(self.largest / self.least)
        return math.expm1((power + 1.0) * span) / (power + 1.0) if power != -1.0 else span


@dataclass(frozen=True, slots=True)
class LogNormal:
    """Sizes whose logarithm is normal: lengths, or apertures."""

    deviation: float = parameter(key="log_normal", above=0, at_most=3, help="deviation of ln size")
    median: float = parameter("m", above=0, help="median size")

    def __post_init__(self) -> None:
        check_fields(self)

    @property
    def mean(self) -> float:
        """Mean, m: median e^(σ²/2)."""
        return self.median * math.exp(0.5 * self.deviation**2)

    def draw(self, rng: np.random.Generator, count: int) -> Array:
        """Sizes (count,) in m."""
        return self.median * np.exp(self.deviation * rng.standard_normal(count))

    def biased(self, rng: np.random.Generator, count: int) -> Array:
        """Sizes (count,) in m with density ∝ size times this law's: its median times e^(σ²)."""
        return math.exp(self.deviation**2) * self.draw(rng, count)


@dataclass(frozen=True, slots=True)
class Exponential:
    """Lengths with an exponential density."""

    mean: float = parameter("m", key="exponential", above=0, help="mean length")

    def __post_init__(self) -> None:
        check_fields(self)

    def draw(self, rng: np.random.Generator, count: int) -> Array:
        """Lengths (count,) in m."""
        return -self.mean * np.log1p(-rng.random(count))

    def biased(self, rng: np.random.Generator, count: int) -> Array:
        """Lengths (count,) in m with density ∝ ℓ times this law's: the sum of two of them."""
        found: Array = self.draw(rng, count) + self.draw(rng, count)
        return found


@dataclass(frozen=True, slots=True)
class VonMises:
    """Angles about a mean; the law is that of the angle itself, not of its double."""

    concentration: float = parameter(
        key="von_mises", at_least=0, at_most=1e6, help="concentration κ about the mean"
    )
    mean: float = parameter("rad", help="mean angle from the x axis, counter-clockwise")

    def __post_init__(self) -> None:
        check_fields(self)

    def draw(self, rng: np.random.Generator, count: int) -> Array:
        """Angles (count,) in rad."""
        return rng.vonmises(self.mean, self.concentration, count)


@dataclass(frozen=True, slots=True)
class Uniform:
    """Angles that are all alike likely between two."""

    limits: tuple[float, float] = parameter(
        "rad", key="uniform", help="least and largest angle, as 0 deg and 180 deg for all"
    )

    def __post_init__(self) -> None:
        check_fields(self)
        if not self.limits[0] < self.limits[1]:
            raise SceneError([("uniform", "the second angle must be above the first")])

    def draw(self, rng: np.random.Generator, count: int) -> Array:
        """Angles (count,) in rad."""
        return self.limits[0] + (self.limits[1] - self.limits[0]) * rng.random(count)


@dataclass(frozen=True, slots=True)
class LengthPower:
    """Apertures that grow with the length of the trace: w = w1 (ℓ / ℓ1)^n."""

    exponent: float = parameter(
        key="length_power", at_least=-2, at_most=2, help="n, the aperture goes as length^n"
    )
    aperture: float = parameter("m", above=0, help="aperture w1 of a trace of the length `at`")
    length: float = parameter("m", key="at", above=0, help="length l1 that has that aperture")

    def __post_init__(self) -> None:
        check_fields(self)

    def of(self, length: Array) -> Array:
        """Apertures of traces of these lengths, m."""
        return self.aperture * (np.asarray(length) / self.length) ** self.exponent


Length = float | PowerLaw | LogNormal | Exponential
Angle = float | VonMises | Uniform
Aperture = float | LogNormal | LengthPower


def draw(law: Length | Angle, rng: np.random.Generator, count: int) -> Array:
    """Values of a law, (count,); one number is that number every time.

    Parameters
    ----------
    law : of the values
    rng : source of randomness
    count : how many
    """
    if isinstance(law, float | int):
        return np.full(count, float(law))
    return law.draw(rng, count)


def apertures(law: Aperture, rng: np.random.Generator, length: Array) -> Array:
    """Hydraulic aperture of traces of these lengths (m), (n,) m.

    Parameters
    ----------
    law : of the apertures
    rng : source of randomness
    length : of the traces, (n,) m
    """
    if isinstance(law, LengthPower):
        return law.of(length)
    return draw(law, rng, len(length))
