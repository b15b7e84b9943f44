# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""Materials of a street as a range finder at 905 nm sees them."""

from __future__ import annotations

import numpy as np

from stri_mapping.simulation.mesh import Surface

# Lambertian reflectance at 905 nm and its spread from one object to the next: rounded values of
# the tables that come with range finders.  A plate or a traffic sign sends light straight back.
MATERIALS: dict[str, tuple[float, float]] = {
    'asphalt': (0.16, 0.03),
    'stone': (0.40, 0.08),
    'plaster': (0.55, 0.12),
    'brick': (0.45, 0.08),
    'concrete': (0.38, 0.06),
    'wood': (0.45, 0.10),
    'blind': (0.60, 0.10),
    'glass': (0.07, 0.02),
    'room': (0.25, 0.08),
    'leaves': (0.45, 0.08),
    'bark': (0.30, 0.05),
    'metal': (0.30, 0.10),
    'paint': (0.35, 0.25),
    'black': (0.06, 0.02),
    'rubber': (0.05, 0.01),
    'cloth': (0.40, 0.20),
    'grass': (0.45, 0.05),
    'reflector': (8.0, 3.0),
}
# Standard deviation of the range bias from one surface to the next, and its limit, metres: the
# outdoor scanners' systematic error is stated as +-35 mm, most of it common to all surfaces.
BIAS, BIAS_LIMIT = 0.005, 0.012


def paint(material: str, rng: np.random.Generator) -> Surface:
    """Return one object's surface: its material's reflectance, varied, and a range bias."""
    mean, spread = MATERIALS[material]
    brightest = 0.95 if mean < 1.0 else 2.0 * mean
    reflectance = float(np.clip(mean + spread * rng.standard_normal(), 0.4 * mean, brightest))
    bias = float(np.clip(BIAS * rng.standard_normal(), -BIAS_LIMIT, BIAS_LIMIT))
    return Surface(material, round(reflectance, 3), round(bias, 4))
