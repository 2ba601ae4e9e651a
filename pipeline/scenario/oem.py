"""Reader of orbit ephemeris messages (OEM, CCSDS 502.0-B) in keyword = value notation."""

import re
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

import numpy as np

from pipeline.arrays import Array, Float
from pipeline.errors import InputError
from pipeline.orbit.forces import point_mass
from pipeline.orbit.reference import YEARS
from pipeline.text import visible

FIRST_LINE = "CCSDS_OEM_VERS"
VERSIONS = ("1.0", "2.0", "3.0")  # which differ in what is not read here
# Frames that differ by a constant rotation of 0.02 arc seconds, which relative motion cancels
FRAMES = ("EME2000", "ICRF", "GCRF")
METHODS = ("LINEAR", "LAGRANGE", "HERMITE")
HIGHEST_DEGREE = 25  # of interpolation; through equally spaced states a higher one loses digits
LARGEST = 1e15  # number in a file, in any unit: beyond it something is wrong
SAME = 1e-6  # s; a state so near in time is propagated, and none is interpolated
_EPOCH = re.compile(r"(\d{4}-(?:\d\d-\d\d|\d{3})T\d\d:\d\d:\d\d)(\.\d+)?Z?")
_COVARIANCE = re.compile(
    r"^COVARIANCE_START(\n(?!COVARIANCE_ST).*)*\nCOVARIANCE_STOP$\n?", re.MULTILINE
)


@dataclass(frozen=True)
class UtcTime:
    """A UTC time with a resolution finer than microseconds."""

    second: datetime  # whole
    fraction: float  # s

    def since(self, time: datetime) -> float:
        """Seconds since a time."""
        return (self.second - time).total_seconds() + self.fraction


@dataclass(frozen=True, eq=False)
class Segment:
    """An OEM segment: states at times, and the interpolation method between them."""

    base: datetime  # that times are counted from
    times: Float[Array, "q"]  # ascending, s
    states: Float[Array, "q 6"]  # m and m/s
    window: tuple[float, float]  # first and last time at which states may be used
    method: str | None  # of METHODS, or None where the file states none
    degree: int

    def state(self, time: float) -> Float[Array, "6"] | None:
        """The state at a time, s since the base, or None where it cannot be interpolated."""
        near = int(np.abs(self.times - time).argmin())
        off = time - self.times[near]
        if abs(off) <= SAME:
            state = self.states[near]
            gravity = point_mass(state[:3])
            return state + off * np.concatenate([state[3:] + off / 2 * gravity, gravity])
        points = (self.degree + 2) // 2 if self.method == "HERMITE" else self.degree + 1
        if self.method is None or len(self.times) < points:
            return None
        first = int(np.searchsorted(self.times, time)) - points // 2
        first = min(max(first, 0), len(self.times) - points)
        return self._interpolated(slice(first, first + points), time)

    def _interpolated(self, chosen: slice, time: float) -> Float[Array, "6"]:
        """Interpolation by the polynomial through some of the states, in scaled time."""
        from scipy.interpolate import KroghInterpolator  # slow to import, and only files need it

        unit = self.times[chosen][-1] - self.times[chosen][0]
        at, states = (self.times[chosen] - time) / unit, self.states[chosen]
        if self.method != "HERMITE":
            return np.asarray(KroghInterpolator(at, states)(0.0))
        both = np.stack([states[:, :3], unit * states[:, 3:]], axis=1).reshape(-1, 3)
        fitted = KroghInterpolator(np.repeat(at, 2), both)
        return np.concatenate([fitted(0.0), fitted.derivative(0.0) / unit])


@dataclass(frozen=True, eq=False)
class Ephemeris:
    """Inertial states of one craft over time."""

    name: str  # of its file
    frame: str
    segments: tuple[Segment, ...]

    @property
    def start(self) -> datetime:
        """The first time at which there is a state, UTC, within a microsecond."""
        return min(one.base + timedelta(seconds=one.window[0]) for one in self.segments)

    def state_at(self, epoch: datetime, seconds: float) -> Float[Array, "6"]:
        """The state so many seconds after an epoch, m and m/s; InputError where there is none."""
        when = f"{(epoch + timedelta(seconds=seconds)):%Y-%m-%dT%H:%M:%S.%fZ}"
        for segment in self.segments:
            time = (epoch - segment.base).total_seconds() + seconds
            begin, end = segment.window
            if not begin - SAME <= time <= end + SAME:
                continue
            if (state := segment.state(time)) is None:
                raise InputError(
                    f"{self.name} has no state at {when} and no INTERPOLATION with enough states "
                    "for its degree; expected either."
                )
            return state
        stop = max(one.base + timedelta(seconds=one.window[1]) for one in self.segments)
        raise InputError(
            f"{self.name} has states from {self.start:%Y-%m-%dT%H:%M:%S.%fZ} to "
            f"{stop:%Y-%m-%dT%H:%M:%S.%fZ}; expected one at {when}."
        )


def ephemeris_from(text: str, name: str) -> Ephemeris:
    """The ephemeris in a file's text; InputError, with its name, for what is not understood.

    States are in km and km/s there. Comments, accelerations and covariances are ignored.
    """
    lines = (line.strip() for line in text.splitlines())
    kept = "\n".join(line for line in lines if line and not line.startswith("COMMENT"))
    header, *parts = re.split(r"^META_START$", _COVARIANCE.sub("", kept), flags=re.MULTILINE)
    try:
        _expect(_keywords(header), FIRST_LINE, VERSIONS)
        metas, segments = zip(*map(_segment, parts), strict=True) if parts else ((), ())
        for keyword in ("OBJECT_ID", "REF_FRAME"):
            values = {meta.get(keyword) for meta in metas}
            if len(values) != 1:
                raise InputError(f"has {len(values)} values of {keyword}; expected one")
    except InputError as error:
        raise InputError(f"{name} {error}.") from error
    return Ephemeris(name, metas[0]["REF_FRAME"], segments)


def _keywords(text: str) -> dict[str, str]:
    """The values of lines keyword = value."""
    found = {}
    for line in text.strip().splitlines():
        keyword, equals, value = map(str.strip, line.partition("="))
        if not equals or keyword in found:
            raise InputError(f"has the line {_shown(line)}; expected keyword = value, each once")
        found[keyword] = value
    return found


def _expect(keywords: dict[str, str], keyword: str, choices: tuple[str, ...]) -> None:
    value = keywords.get(keyword)
    if value not in choices:
        given = f"{keyword} {_shown(value)}" if value else f"no {keyword}"
        raise InputError(f"has {given}; expected {' or '.join(choices)}")


def _segment(text: str) -> tuple[dict[str, str], Segment]:
    """The keywords and the states of what follows META_START."""
    head, stop, body = text.partition("\nMETA_STOP")
    if not stop:
        raise InputError("has META_START without META_STOP; expected both")
    keywords = _keywords(head)
    _expect(keywords, "CENTER_NAME", ("EARTH",))
    _expect(keywords, "REF_FRAME", FRAMES)
    _expect(keywords, "TIME_SYSTEM", ("UTC",))
    rows = [_row(line) for line in body.strip().splitlines()]
    if not rows:
        raise InputError("has a segment without states; expected at least one")
    base = rows[0][0].second
    times = np.array([epoch.since(base) for epoch, _ in rows])
    if (np.diff(times) <= 0).any():
        late = int((np.diff(times) <= 0).argmax()) + 1
        raise InputError(
            f"has state {late} of a segment no later than the one before it; expected them in "
            "order of time"
        )
    window = (
        max(float(times[0]), _time(keywords, "USEABLE_START_TIME", base, -np.inf)),
        min(float(times[-1]), _time(keywords, "USEABLE_STOP_TIME", base, np.inf)),
    )
    if not window[0] <= window[1]:
        raise InputError(
            "has a segment whose USEABLE_START_TIME and USEABLE_STOP_TIME leave none of its time; "
            "expected the one before the other, and states around them"
        )
    states = 1e3 * np.array([state for _, state in rows])
    return keywords, Segment(base, times, states, window, *_interpolation(keywords))


def _time(keywords: dict[str, str], keyword: str, base: datetime, otherwise: float) -> float:
    value = keywords.get(keyword)
    return otherwise if value is None else _epoch(value).since(base)


def _interpolation(keywords: dict[str, str]) -> tuple[str | None, int]:
    """Method and degree of interpolation."""
    method = keywords.get("INTERPOLATION", "").upper()
    if not method:
        return None, 0
    _expect({"INTERPOLATION": method}, "INTERPOLATION", METHODS)
    degree = keywords.get("INTERPOLATION_DEGREE", "")
    if not degree.isdecimal() or not 1 <= float(degree) <= HIGHEST_DEGREE:
        given = _shown(degree) if degree else "missing"
        raise InputError(f"has INTERPOLATION_DEGREE {given}; expected 1 to {HIGHEST_DEGREE}")
    return method, int(degree)


def _row(line: str) -> tuple[UtcTime, list[float]]:
    """Epoch and state of a line, km and km/s; accelerations may follow."""
    first, *rest = line.split()
    try:
        numbers = [float(one) for one in rest]
    except ValueError:
        numbers = []
    if len(numbers) not in (6, 9) or not all(abs(one) < LARGEST for one in numbers):
        raise InputError(
            f"has the line {_shown(line)}; expected an epoch and x y z vx vy vz in km and km/s"
        )
    return _epoch(first), numbers[:6]


def _epoch(text: str) -> UtcTime:
    """The epoch of a text: a calendar date or the day of a year, and the time."""
    found = _EPOCH.fullmatch(text)
    try:
        if found is None:
            raise ValueError
        form = "%Y-%m-%dT%H:%M:%S" if found[1].count("-") == 2 else "%Y-%jT%H:%M:%S"
        second = datetime.strptime(found[1], form).replace(tzinfo=UTC)
        if second.year != int(found[1][:4]) or not YEARS[0] < second.year < YEARS[1]:
            raise ValueError  # day 366 of another year than a leap year is the next year's first
    except ValueError as error:
        raise InputError(
            f"has the time {_shown(text)}; expected UTC such as 2026-03-01T12:00:00.000, and no "
            "leap second"
        ) from error
    return UtcTime(second, float(found[2] or 0.0))


def _shown(text: str) -> str:
    return repr(visible(text if len(text) <= 60 else f"{text[:57]}..."))
