"""The `--truth` file of a flight and the marks it is given.

The file is written by the simulator: one row per sample, `t_s, x, y, z, yaw, contact, est_x, est_y, est_z, est_yaw,
localized, roll, pitch`, metres NED about home, radians. Nothing here is shared with Kestrel: angles, distances and percentiles are
computed again, so that a mistake of the program cannot hide in its own test.
"""

import csv
import math
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Sample:
    """One row: where the vehicle was and where it believed to be."""

    t_s: float
    x: float
    y: float
    z: float
    yaw: float
    contact: bool
    est_x: float
    est_y: float
    est_z: float
    est_yaw: float
    localized: bool
    roll: float
    pitch: float

    @property
    def position_error(self):
        """Distance between estimate and truth, m."""
        return math.dist((self.x, self.y, self.z), (self.est_x, self.est_y, self.est_z))

    @property
    def horizontal_error(self):
        """Distance between estimate and truth on the plan, m."""
        return math.hypot(self.x - self.est_x, self.y - self.est_y)

    @property
    def yaw_error(self):
        """Estimate minus truth, rad, in -pi..pi."""
        return wrap(self.est_yaw - self.yaw)


def wrap(angle):
    """The same direction in -pi..pi."""
    return math.atan2(math.sin(angle), math.cos(angle))


def percentile(values, percent):
    """Nearest-rank percentile."""
    ordered = sorted(values)
    return ordered[max(0, math.ceil(percent / 100 * len(ordered)) - 1)]


def rms(values):
    """Root of the mean square."""
    values = list(values)
    return math.sqrt(sum(v * v for v in values) / len(values))


def mean(values):
    """Arithmetic mean."""
    values = list(values)
    return sum(values) / len(values)


class Truth:
    """All samples of a flight, or a part of it."""

    AIRBORNE_M = 0.15  # higher than this above the floor counts as flying

    def __init__(self, samples):
        self.samples = samples

    @classmethod
    def read(cls, path):
        """Reads the file; a last line cut off by a kill is left out."""
        names = [f.strip() for f in Sample.__dataclass_fields__]
        samples = []
        with open(path, newline="") as file:
            rows = csv.reader(line for line in file if not line.startswith("#"))
            header = [name.strip() for name in next(rows)]
            missing = [name for name in names if name not in header]
            assert not missing, f"{path}: columns {missing} are missing; there are {header}"
            columns = [header.index(name) for name in names]
            for row in rows:
                if len(row) < len(header):
                    continue
                cells = [row[i].strip() for i in columns]
                values = [float(c) if c else math.nan for c in cells]
                values[5] = values[5] == 1.0
                values[10] = values[10] == 1.0
                samples.append(Sample(*values))
        assert samples, f"{path} holds no sample"
        return cls(samples)

    def between(self, start_s, end_s=math.inf):
        """The part of the flight in this time, vehicle seconds."""
        part = Truth([s for s in self.samples if start_s <= s.t_s <= end_s])
        first, last = self.samples[0].t_s, self.samples[-1].t_s
        assert part.samples, f"no truth in {start_s:.2f}..{end_s:.2f} s (the file covers {first:.2f}..{last:.2f} s)"
        return part

    def at(self, t_s):
        """The sample nearest to a time."""
        return min(self.samples, key=lambda s: abs(s.t_s - t_s))

    @property
    def first(self):
        return self.samples[0]

    @property
    def last(self):
        return self.samples[-1]

    def airborne(self):
        """From the first to the last sample in the air."""
        flying = [s.t_s for s in self.samples if s.z < -self.AIRBORNE_M]
        assert flying, "never took off"
        return self.between(flying[0], flying[-1])

    @property
    def has_flown(self):
        return any(s.z < -self.AIRBORNE_M for s in self.samples)

    def contacts(self):
        """How many times it touched a wall, furniture or a person."""
        touching = [False] + [s.contact for s in self.samples]
        return sum(now and not before for before, now in zip(touching, touching[1:]))

    def path_length(self):
        """Way flown on the plan, m, counted in steps of at least 5 cm so that jitter adds nothing."""
        length, here = 0.0, self.samples[0]
        for s in self.samples:
            step = math.hypot(s.x - here.x, s.y - here.y)
            if step >= 0.05:
                length, here = length + step, s
        return length

    def spread(self):
        """Largest distance from the mean place on the plan, m: how still a hover was."""
        centre = (mean(s.x for s in self.samples), mean(s.y for s in self.samples))
        return max(distance(s, centre) for s in self.samples)

    def nearest(self, point):
        """Smallest distance to a point NED, m; two coordinates compare on the plan, three in space."""
        return min(distance(s, point) for s in self.samples)

    def passes(self, points, within_m):
        """Smallest distances to points that must be passed in this order, each after the one before came near."""
        distances, start = [], 0
        for point in points:
            rest = [distance(s, point) for s in self.samples[start:]]
            distances.append(min(rest))
            near = next((i for i, d in enumerate(rest) if d <= within_m), None)
            start += rest.index(min(rest)) if near is None else near
        return distances

    def landing_error(self, point=(0.0, 0.0)):
        """Distance of the last sample from a place on the plan (home), m."""
        assert self.last.z > -self.AIRBORNE_M, f"still {-self.last.z:.2f} m high at the end"
        return distance(self.last, point)

    def localized(self):
        """Samples in which the vehicle claims to know where it is."""
        return Truth([s for s in self.samples if s.localized])


def distance(sample, point):
    """Distance of the vehicle from a point of two or three coordinates, m."""
    return math.dist((sample.x, sample.y, sample.z)[: len(point)], point)


@dataclass(frozen=True)
class EstimateError:
    """How far the estimate was from the truth."""

    mean_m: float
    p95_m: float
    yaw_rms_deg: float

    @classmethod
    def of(cls, samples):
        """Over these samples, estimate taken as it was, localized or not."""
        samples = list(samples)
        errors = [s.position_error for s in samples]
        return cls(mean(errors), percentile(errors, 95), math.degrees(rms(s.yaw_error for s in samples)))

    def __str__(self):
        return f"mean {self.mean_m:.3f} m, p95 {self.p95_m:.3f} m, yaw rms {self.yaw_rms_deg:.2f} deg"
