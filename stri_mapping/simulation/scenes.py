# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""The drives by name."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stri_mapping.errors import UsageError
from stri_mapping.simulation import campus, motion, route
from stri_mapping.simulation.highway import highway
from stri_mapping.simulation.materials import paint
from stri_mapping.simulation.mesh import MeshBuilder
from stri_mapping.simulation.motion import KNOT, Path
from stri_mapping.simulation.ride import drive
from stri_mapping.simulation.scene import Scene
from stri_mapping.simulation.site import Site
from stri_mapping.simulation.slope import sloped_mesh, sloped_motion
from stri_mapping.simulation.street import Profile, street
from stri_mapping.simulation.traffic import ordinary, Traffic

Array = NDArray[np.float64]
KMH = 1.0 / 3.6


@dataclass(frozen=True)
class Options:
    """
    What may be asked of a scene.

    Attributes
    ----------
    seed
        Draws everything that is random.
    duration
        Seconds; None for the scene's own.
    vibration
        Scale of roll, pitch and heave: 1 for an ordinary car, 0 for none.
    traffic
        How much moves in the street: 1 for an ordinary one, 0 for nothing.
    slope, crossfall
        Percent by which the ground rises along odom's x, the way most scenes begin, and along y,
        to the left of it.

    """

    seed: int = 1
    duration: float | None = None
    vibration: float = 1.0
    traffic: float = 1.0
    slope: float = 0.0
    crossfall: float = 0.0

    def check(self) -> None:
        """Raise UsageError naming the option that is out of range."""
        limits = {'seed': (0, 2**32 - 1), 'duration': (0.5, 36000.0), 'vibration': (0.0, 10.0),
                  'traffic': (0.0, 10.0), 'slope': (-20.0, 20.0), 'crossfall': (-20.0, 20.0)}
        for name, (low, high) in limits.items():
            value = getattr(self, name)
            if value is not None and not low <= value <= high:
                raise UsageError(f'{name} is {value}, want {low} to {high}')


def make_scene(name: str, options: Options = Options()) -> Scene:
    """
    Return a scene by name.

    Raises
    ------
    UsageError
        If there is no such scene, or an option is out of range.

    """
    if name not in SCENES:
        raise UsageError(f'unknown scene "{name}"; known are {", ".join(SCENES)}')
    options.check()
    return SCENES[name](name, options)


class Draft:
    """A scene in the making: its options, its site, and random numbers for each purpose."""

    def __init__(self, name: str, options: Options) -> None:
        """Begin with nothing built."""
        self.name, self.options = name, options
        # own numbers for each purpose: without traffic the street and the ride are the same
        self.rng, self._ride, self._traffic, self._sky = (
            np.random.default_rng((options.seed, i)) for i in range(4))
        self.site = Site(MeshBuilder(), self.rng, {}, np.eye(4))

    def seconds(self, own: float, longest: float = np.inf) -> float:
        """
        Return the duration asked for, or the scene's own.

        Raises
        ------
        UsageError
            If more is asked for than the scene has.

        """
        wanted = self.options.duration or own
        if wanted > longest:
            raise UsageError(f'{self.name} lasts {longest:.1f} s, duration {wanted} is longer')
        return wanted

    def ground(self, path: Path) -> None:
        """Lay asphalt everywhere the path comes near."""
        x, y, _ = path.at(np.linspace(0.0, path.length, 200)).T
        self.site.level((x.min() - 150, y.min() - 150), (x.max() + 150, y.max() + 150), 0.0,
                        paint('asphalt', self.rng))

    def traffic(self, path: Path, distance: Array) -> Traffic:
        """Return the traffic around a vehicle at arc length (n,) at the knots."""
        return Traffic(path, distance, np.asarray(np.arange(len(distance)) * KNOT), self._traffic)

    def sun(self) -> Array | None:
        """Return the direction of a sun that stands somewhere, or None on an overcast day."""
        azimuth, height = self._sky.uniform(0.0, 2.0 * np.pi), self._sky.uniform(0.02, 0.9)
        if self._sky.random() < 0.5:
            return None
        return np.array([np.cos(height) * np.cos(azimuth), np.cos(height) * np.sin(azimuth),
                         np.sin(height)])

    def scene(self, path: Path, distance: Array, duration: float,
              traffic: Traffic | None = None) -> Scene:
        """Return the scene with all that was built."""
        moving = drive(path, distance, self._ride, self.options.vibration)
        movers = () if traffic is None else tuple(traffic.movers)
        facts = dict(self.site.facts)
        if traffic is not None:
            facts['movers'] = traffic.facts()
        sun = None if traffic is None else self.sun()
        if sun is not None:
            facts['sun'] = sun.round(4).tolist()
        mesh, grade = self.site.builder.mesh(), 0.01 * np.array([self.options.slope,
                                                                self.options.crossfall])
        if grade.any():
            mesh, moving = sloped_mesh(mesh, grade), sloped_motion(moving, grade)
        return Scene(self.name, mesh, moving, duration, movers, sun, facts, grade)


def _campus(name: str, options: Options) -> Scene:
    """170 m along columns every 6 m, 11 to 30 km/h, the paper's own speed profile."""
    draft = Draft(name, options)
    duration = draft.seconds(34.0, 34.0)
    campus.campus(draft.site)
    speed = motion.paper_speed(motion.times(34.0), 170.0, 34.0)
    return draft.scene(Path([(200.0, 0.0)]), motion.distance_along(speed), duration)


def _bare_wall(name: str, options: Options) -> Scene:
    """Columns, 93 m of bare wall, columns again: motion along the bare wall is hidden."""
    draft = Draft(name, options)
    duration = draft.seconds(40.0, 40.0)
    campus.bare_wall(draft.site)
    speed = motion.random_speed(motion.times(40.0), draft.rng, 10 * KMH, 30 * KMH)
    speed *= 205.0 / motion.distance_along(speed)[round(40.0 / KNOT)]
    return draft.scene(Path([(260.0, 0.0)]), motion.distance_along(speed), duration)


def _street(name: str, options: Options) -> Scene:
    """Shops and houses, parked cars, trees, people, traffic, a lane change and back."""
    draft = Draft(name, options)
    duration = draft.seconds(60.0)
    speed = motion.random_speed(motion.times(duration), draft.rng, 10 * KMH, 30 * KMH)
    distance = motion.distance_along(speed)
    length = float(distance[-1])
    swerve = motion.lane_change(28.0, 1.5)
    before = draft.rng.uniform(0.25, 0.5) * length
    path = Path([(before, 0.0), *swerve, (30.0, 0.0), *((s, -turn) for s, turn in swerve),
                 (length, 0.0)])
    draft.ground(path)
    street(draft.site.at(-60.0, 0.0), length + 120.0)
    traffic = draft.traffic(path, distance)
    ordinary(traffic, options.traffic)
    return draft.scene(path, distance, duration, traffic)


def _stops(name: str, options: Options, second: str = 'car') -> Scene:
    """Stop and go on two lanes: three stops, people cross, two vehicles keep alongside."""
    draft = Draft(name, options)
    points, stops, t = [(0.0, draft.rng.uniform(4.0, 7.0))], [], 4.0
    for _ in range(3):
        cruise, halt = draft.rng.uniform(5.0, 8.5), draft.rng.uniform(4.0, 7.0)
        points += [(t + 3.0, cruise), (t + 8.0, cruise), (t + 11.5, 0.0), (t + 11.5 + halt, 0.0)]
        stops.append(t + 11.5)
        t += 11.5 + halt
    points += [(t + 4.0, 7.0), (t + 8.0, 7.0)]
    duration = draft.seconds(points[-1][0], points[-1][0])
    distance = motion.distance_along(motion.speed_through(motion.times(points[-1][0]), points))
    path = Path([(float(distance[-1]) + 60.0, 0.0)])
    draft.ground(path)
    street(draft.site.at(-60.0, 0.0), float(distance[-1]) + 120.0, Profile(left=12.4))
    traffic = draft.traffic(path, distance)
    if options.traffic > 0.0:
        traffic.alongside('car', stops[0] - 3.0, 0.8, 3.3)
        traffic.alongside(second, stops[1] - 4.0, 1.6, 3.5)
        for stop in stops:
            traffic.crossing(traffic.distance_at(stop) + draft.rng.uniform(3.5, 5.0),
                             stop + 0.5, draft.rng.uniform(1.0, 1.6), 10.0)
    ordinary(traffic, 0.5 * options.traffic, lane=6.0, pavement=(10.2, 12.0))
    return draft.scene(path, distance, duration, traffic)


def _bus(name: str, options: Options) -> Scene:
    """As `_stops`, but a bus fills the view for seconds while the vehicle brakes."""
    return _stops(name, options, 'bus')


def _reverse(name: str, options: Options) -> Scene:
    """Backwards along a street, 88 m, with a halt and a slight bend."""
    draft = Draft(name, options)
    duration = draft.seconds(36.0, 36.0)
    points = [(0.0, 0.0), (2.0, 0.0), (6.0, -4.0), (13.0, -2.2), (17.0, 0.0), (19.0, 0.0),
              (23.0, -4.2), (31.0, -2.6), (36.0, -2.6)]
    distance = motion.distance_along(motion.speed_through(motion.times(36.0), points))
    distance *= -88.0 / distance[round(36.0 / KNOT)]
    path = Path([(30.0, 0.05), (25.0, -0.09), (45.0, 0.04)])
    draft.ground(path)
    street(draft.site.at(-60.0, 0.0), 220.0)
    traffic = draft.traffic(path, 100.0 + distance)
    ordinary(traffic, options.traffic)
    return draft.scene(path, 100.0 + distance, duration, traffic)


def _highway(name: str, options: Options) -> Scene:
    """60 to 80 km/h where little stands, overtaken and overtaking."""
    draft = Draft(name, options)
    duration = draft.seconds(40.0)
    speed = motion.random_speed(motion.times(duration), draft.rng, 60 * KMH, 80 * KMH, 10.0)
    distance = motion.distance_along(speed)
    path = Path([(float(distance[-1]) + 50.0, 0.0)])
    highway(draft.site, -100.0, float(distance[-1]) + 120.0)
    traffic = draft.traffic(path, distance)
    rng, time = traffic.rng, 3.0
    while options.traffic > 0.0 and time < duration:
        kind = str(rng.choice(['car', 'estate', 'van', 'truck']))
        traffic.alongside(kind, time, rng.uniform(3.0, 8.0), 3.75)
        for _ in range(2):
            traffic.oncoming(kind, time + rng.uniform(0.0, 6.0), rng.uniform(22.0, 30.0), 10.5)
        time += rng.uniform(6.0, 12.0) / options.traffic
    return draft.scene(path, distance, duration, traffic)


def _way(draft: Draft, legs: list[route.Leg], own: float | None) -> Scene:
    """Return a drive along legs whose streets are built, as long as asked for."""
    path, corners = route.path_along(legs)
    distance = route.distance_on(path, corners, draft.rng, 12 * KMH, 30 * KMH)
    longest = (len(distance) - 11) * KNOT
    duration = draft.seconds(own or longest, longest)
    draft.ground(path)
    traffic = draft.traffic(path, distance)
    ordinary(traffic, draft.options.traffic)
    return draft.scene(path, distance, duration, traffic)


def _corner(name: str, options: Options) -> Scene:
    """Down one street and round a corner into the next, left or right by the seed."""
    draft = Draft(name, options)
    turn = float(draft.rng.choice([-1.0, 1.0])) * np.deg2rad(draft.rng.uniform(75.0, 95.0))
    legs = [route.Leg(115.0, turn), route.Leg(125.0)]
    route.build_streets(draft.site, legs)
    return _way(draft, legs, None)


def _loop(name: str, options: Options) -> Scene:
    """Once round a block of houses, 1 km, back to the very start."""
    draft = Draft(name, options)
    right, long, short = 0.5 * np.pi, 275.0, 237.0
    block = [route.Leg(side, right) for side in (long, short, long, short)]
    route.build_streets(draft.site.at(-0.5 * long, 0.0), block, before=right)
    half = route.Leg(0.5 * long, right)
    return _way(draft, [half, *block[1:], route.Leg(0.5 * long)], None)


def _city(name: str, options: Options) -> Scene:
    """Street after street, corner after corner, as long as --duration says (120 s)."""
    draft = Draft(name, options)
    own = options.duration or 120.0
    legs = route.staircase(draft.rng, own * 30 * KMH)
    route.build_streets(draft.site, legs)
    return _way(draft, legs, own)


SCENES: dict[str, Callable[[str, Options], Scene]] = {
    'campus': _campus, 'street': _street, 'corner': _corner, 'stops': _stops, 'bus': _bus,
    'bare_wall': _bare_wall, 'reverse': _reverse, 'highway': _highway, 'loop': _loop,
    'city': _city,
}
