# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""Settings of the estimator and of the joint fit in it; every default is usable."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

KNOWN_PULL_SIGMA = 0.5e-5   # 1/m, of a pull that an earlier drive has told


@dataclass(frozen=True)
class JointConfig:
    """
    Settings of the joint fit.

    Attributes
    ----------
    active
        Knots that are still fitted.
    kept
        Knots that are not final yet, but laid anew where a lost motion is taken up; as many as
        `active` where scans are rare.
    lags
        Keyframes back that a new one is paired with.
    distances
        Metres back along the path that a new one is paired with.
    span
        Seconds of scans merged in a keyframe besides those of its own knot interval.
    jerk, angular_jerk, acceleration, angular_acceleration
        Standard deviations of the motion's third and second derivatives, SI units; those of
        the accelerations are 2 m/s^2 and 2 rad/s^2 where scans are rare.
    turn
        Standard deviation of the turn rate, rad/s: where nothing tells it, the way is straight.
    slip, slip_arm
        Standard deviation of base_link's sideways speed, m/s, infinite for a vehicle that can go
        sideways; and metres by which the axle that does not slip may be off base_link.
    far
        Metres beyond which returns are not used.
    start_steps
        Knot intervals collected before the first fit.
    iterations
        Of Gauss-Newton, at most, for each new knot.
    pull, pull_sigma, pulls
        Of slanted footprints, 1/m, before anything is learnt of it, and how sure that is (see
        `range_error`): 4e-5 for a beam of 11.9 mrad on a real street, less for a narrow one; and
        how likely it is that there is such a pull at all (see `slant`).
    learn_error
        Whether the pull is learnt and corrected.
    judge_surfaces
        Whether moving objects are told and left out as wholes; where scans are too rare to
        follow surfaces it is not done in any case.

    """

    active: int = 12
    kept: int = 17
    lags: tuple[int, ...] = (1, 2, 4, 7)
    distances: tuple[float, ...] = (3.0, 6.0, 10.0, 20.0)
    span: float = 0.1
    jerk: float = 6.0
    angular_jerk: float = 3.0
    acceleration: float = 4.0
    angular_acceleration: float = 0.5
    turn: float = 0.4
    slip: float = 0.07
    slip_arm: float = 0.5
    far: float = 80.0
    start_steps: int = 8
    iterations: int = 7
    pull: float = 3e-5
    pull_sigma: float = 1.5e-5
    pulls: float = 0.5
    learn_error: bool = True
    judge_surfaces: bool = True


@dataclass(frozen=True)
class EstimatorConfig:
    """
    Settings of the estimator; every default is usable.

    Attributes
    ----------
    knot_spacing
        Seconds between knots of the path; slow scanners get one scan period.
    degenerate_sigma
        Standard deviation of the forward speed in m/s above which it counts as not observable.
    lost_sigma
        Standard deviation of the speed in m/s above which another motion is looked for.
    image_window
        Seconds of the range image kept for pictures.
    joint
        Settings of the joint fit.

    """

    knot_spacing: float = 0.1
    degenerate_sigma: float = 0.2
    lost_sigma: float = 0.4
    image_window: float = 8.0
    joint: JointConfig = field(default_factory=JointConfig)

    def knowing(self, pull: float | None) -> EstimatorConfig:
        """Return the same settings for a scanner whose footprint pull is known, 1/m or None."""
        if pull is None:
            return self
        return replace(self, joint=replace(
            self.joint, pull=pull, pull_sigma=KNOWN_PULL_SIGMA, pulls=1.0))
