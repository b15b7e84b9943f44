# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""
Which surfaces stand still: moving objects are left out as wholes.

A surface that comes into view counts little until it has agreed with the motion that the known
ones tell.  One that comes to, or leaves, places that other keyframes see through (see `sight`)
loses its weight, all of it, its sides that slide along themselves included.  So a bus that draws
alongside is out before it hides the street, and when it hides everything, nothing is left to be
misled by.  Where known surfaces fall silent, or a single one tells all, it is the motion that is
in doubt.

And a surface is one witness, however many rays it has: they err alike, on a bonnet that slopes as
the body pitches, on a lorry that creeps.  The more one tells of the motion, the less each of its
residuals counts, so that two cars beside the road do not shout down the steps of a facade.  And
the less it counts, the further it has been apart from the others: on the slopes of bodywork the
scan plane climbs as the vehicle pitches, which shows as motion; on what is upright it does not.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

LABELS = 8192          # surfaces told apart at a time; numbers wrap around
NEW = 0.1              # weight of a surface just come into view
GAIN, SLOW_GAIN, LOSS = 0.35, 0.1, 0.7
AGREES, DISAGREES = 0.7, 0.5
ENOUGH = 2.0           # votes below which nothing can be said
USUAL_ROUNDS = 24.0    # comparisons that the numbers above are meant for
FORGET = 0.8           # of what a surface used to say, from fit to fit
KNOWN = 0.5            # weight above which a surface is known to stand
MOVES = 0.05           # weight below which a surface is known to move
WITNESS = 100.0        # votes of a surface at which its residuals count half
STEADY = 0.01          # metres from all others, beyond which the votes of a surface weigh more
WAYWARD = 10.0         # times that they weigh at most
WORSE, BETTER = 0.2, 0.02    # of its distance from all others that is learnt from fit to fit


class Trust:
    """
    Weights of the surfaces by number modulo `LABELS`.

    Attributes
    ----------
    weight
        (LABELS,) from 0, left out, to 1.
    votes
        (LABELS + 1,) weight of the surfels that see motion along the way and agree with the fit;
        the last counts the comparisons.
    through
        (LABELS,) count of rays that come from where earlier keyframes saw through.
    testimony
        (2, LABELS) of each surface about the motion along the way, see `pairs.testify`.
    agreement
        How much of what surfaces known to stand used to say for the motion they say now.
    alone
        Share of what is said for the motion that a single surface says.

    """

    def __init__(self) -> None:
        """Trust all that is there at the start: nothing tells them apart."""
        self.weight = np.ones(LABELS)
        self.votes, self.through = np.zeros(LABELS + 1), np.zeros(LABELS)
        self.testimony = np.zeros((2, LABELS))
        self._wander = np.full(LABELS, STEADY ** 2)     # square metres from all others, lately
        self._moved = np.zeros(LABELS, np.bool_)
        self._usual = np.zeros(LABELS)           # agreeing weight of a surface's ray, lately
        self._said = np.zeros(LABELS)            # agreeing weight of a surface, lately
        self.agreement, self.alone = 1.0, 0.0
        self._known = 0

    def add(self, surfaces: int) -> None:
        """Take the surfaces that have come into view, by the count of numbers given so far."""
        new = np.arange(self._known, surfaces) % LABELS
        self.weight[new], self._moved[new] = NEW, False
        self._usual[new] = self._said[new] = 0.0
        self._wander[new] = STEADY ** 2
        self._known = surfaces

    def of_residuals(self) -> Array:
        """Return the weight (LABELS,) of each surface's residuals: none of those that move."""
        said = self._said * np.clip(self._wander / STEADY ** 2, 1.0, WAYWARD)
        return np.where(self.weight < MOVES, 0.0, self.weight / (1.0 + said / WITNESS))

    def reset(self) -> None:
        """Forget votes and testimony, before a fit in which they are heard anew."""
        self.votes[:] = self.through[:] = 0.0
        self.testimony[:] = 0.0

    def update(self, labels: Array, certain: bool, clear: bool) -> None:
        """
        Judge every surface by its votes since they were last cleared.

        Parameters
        ----------
        labels
            (n,) surface of each of the newest rays.
        certain
            Whether the vehicle's motion is known: if not, disagreement condemns nobody, nor does
            agreement clear what was seen to move.
        clear
            Whether enough is seen to tell who is apart from the others: else those that are right
            may be the few.

        """
        agree = USUAL_ROUNDS * self.votes[:-1] / max(self.votes[-1], 1.0)
        rays = np.bincount(labels[labels >= 0].astype(np.int64) % LABELS, minlength=LABELS)
        self._compare(agree, rays)
        if clear:
            self._learn()
        self._said = np.maximum(agree, self._usual * rays)
        told = self.weight * agree / (1.0 + agree / WITNESS)
        self.alone = float(told.max() / max(told.sum(), 1e-9))
        whole = agree + self.through
        heard = whole > ENOUGH
        share = agree / np.maximum(whole, 1e-9)
        rise = heard & (share > AGREES) & (certain | ~self._moved)
        fall = heard & (share < DISAGREES)
        gain = np.where(self.weight < MOVES, SLOW_GAIN, GAIN)
        self.weight[rise] += (gain * (1.0 - self.weight))[rise]
        if certain:
            self.weight[fall] *= 1.0 - LOSS
        self._moved = (self._moved | (self.weight < MOVES)) & (self.weight < KNOWN)

    def _compare(self, agree: Array, rays: NDArray[np.int64]) -> None:
        """Bring the agreement up to date: what known surfaces say now and what they used to."""
        known = (self.weight > KNOWN) & (rays > 0)
        used_to = float((self._usual * rays)[known].sum())
        if used_to > ENOUGH:
            share = min(float(agree[known].sum()) / used_to, 1.0)
            self.agreement += 0.6 * (share - self.agreement)
        self._usual *= FORGET
        seen = rays > 0
        self._usual[seen] = np.maximum(self._usual[seen], agree[seen] / rays[seen])

    def _learn(self) -> None:
        """Learn how far each surface is from what all of them say."""
        heard = np.flatnonzero(self.testimony[0] > ENOUGH)
        information, said = self.testimony[:, heard]
        change = (said / information) ** 2 - self._wander[heard]
        self._wander[heard] += np.where(change > 0.0, WORSE, BETTER) * change

    def pardon(self) -> None:
        """Trust all again but those known to move."""
        self.weight[~self._moved] = 1.0
        self.agreement = 1.0
