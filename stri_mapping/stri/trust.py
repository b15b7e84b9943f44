# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""
Which surfaces stand still: moving objects are left out as wholes.

A surface that comes into view counts little until it has agreed with the motion that the known
ones tell; one that disagrees loses its weight, all of it, its sides that slide along themselves
included.  So a bus that draws alongside is out before it hides the street, and when it hides
everything, nothing is left to be misled by.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

LABELS = 1024          # surfaces told apart at a time; numbers wrap around
NEW = 0.1              # weight of a surface just come into view
GAIN, LOSS = 0.35, 0.5
AGREES, DISAGREES = 0.5, 0.3
ENOUGH = 2.0           # votes below which nothing can be said
MOVES = 0.03           # weight below which a surface is known to move


class Trust:
    """
    Weights of the surfaces by number modulo `LABELS`.

    Attributes
    ----------
    weight
        (LABELS,) from 0, left out, to 1.
    votes
        (LABELS, 2) accepted and whole weight of the surfels that see motion along the way,
        collected by the fit.
    agreement
        Share of all votes that are for the motion found, over the last few fits.

    """

    def __init__(self) -> None:
        """Trust all that is there at the start: nothing tells them apart."""
        self.weight = np.ones(LABELS)
        self.votes = np.zeros((LABELS, 2))
        self.agreement = 1.0

    def add(self, surfaces: int, parents: NDArray[np.int32]) -> None:
        """
        Take surfaces that have come into view.

        Parameters
        ----------
        surfaces
            Numbers given so far.
        parents
            (n,) of the n newest: the surface each split off from, -1 for none.

        """
        for i, parent in enumerate(parents):
            number = (surfaces - len(parents) + i) % LABELS
            self.weight[number] = NEW if parent < 0 else self.weight[parent % LABELS]

    def update(self, certain: bool) -> None:
        """
        Judge every surface by its votes since they were last cleared.

        Parameters
        ----------
        certain
            Whether the vehicle's motion is known: if not, disagreement condemns nobody.

        """
        accepted, whole = self.votes.T
        if whole.sum() > 5.0 * ENOUGH:
            self.agreement += 0.3 * (accepted.sum() / whole.sum() - self.agreement)
        heard = whole > ENOUGH
        share = accepted / np.maximum(whole, 1e-9)
        rise = heard & (share > AGREES)
        fall = heard & (share < DISAGREES)
        self.weight[rise] += GAIN * (1.0 - self.weight[rise])
        if certain:
            self.weight[fall] *= 1.0 - LOSS

    def pardon(self) -> None:
        """Trust all again but those known to move."""
        self.weight[self.weight >= MOVES] = 1.0
        self.agreement = 1.0
