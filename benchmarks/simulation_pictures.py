# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""Draw each virtual scene from above beside its range image: docs/simulation/<scene>.png."""

from __future__ import annotations

import argparse
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
import numpy as np
from numpy.typing import NDArray

from stri_mapping.simulation.drive import Drive, make_drive
from stri_mapping.simulation.mesh import Mesh
from stri_mapping.simulation.scenes import Options, SCENES
from stri_mapping.vehicle import default_vehicle_file, load_vehicle, Vehicle

Array = NDArray[np.float64]


def plan(mesh: Mesh, height: float) -> Array:
    """Return the lines (k, 2, 2) in which a mesh cuts the level plane at a height."""
    above = mesh.triangles[:, :, 2] > height
    cut = mesh.triangles[above.any(axis=1) & ~above.all(axis=1)]
    corner, after = cut, np.roll(cut, -1, axis=1)
    with np.errstate(divide='ignore', invalid='ignore'):
        share = (height - corner[..., 2]) / (after[..., 2] - corner[..., 2])
    crossed = (share >= 0.0) & (share <= 1.0)
    points = corner + np.where(crossed, share, 0.0)[..., None] * (after - corner)
    two = crossed.sum(axis=1) == 2
    return np.asarray(points[two][crossed[two]].reshape(-1, 2, 3)[..., :2])


def draw(drive: Drive, path: Path) -> None:
    """Draw one scene: a long street above its range image, others beside it."""
    scene = drive.scene
    poses = scene.motion.at(np.arange(0.0, scene.duration, 0.05))
    low, high = poses[:, :2].min(0) - 25.0, poses[:, :2].max(0) + 25.0
    long = (high - low)[0] > 2.5 * (high - low)[1]
    figure = Figure(figsize=(11.0, 5.2), dpi=90, layout='constrained')
    grid = (figure.add_gridspec(2, 1, height_ratios=(1.0, 2.2)) if long
            else figure.add_gridspec(1, 2))
    above, image = figure.add_subplot(grid[0]), figure.add_subplot(grid[1])
    draw_plan(above, drive, poses)
    above.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect='equal', xlabel='x (m)',
              ylabel='y (m)', title=f'{scene.name}, seed {drive.seed}: from above at 1.2 m')
    draw_range_image(figure, image, drive)
    figure.savefig(path, pil_kwargs={'optimize': True})


def draw_plan(axes: Axes, drive: Drive, poses: Array) -> None:
    """Draw the surfaces at 1.2 m, the vehicle's path in blue, and what moves in orange."""
    scene = drive.scene
    axes.add_collection(LineCollection(list(plan(scene.mesh, 1.2)), colors='0.25', linewidths=0.5))
    for mover in scene.movers:
        way = mover.at(np.arange(mover.begin, min(mover.end, scene.duration), 0.2))
        axes.plot(way[:, 0], way[:, 1], color='tab:orange', lw=0.6, alpha=0.7)
    axes.plot(poses[:, 0], poses[:, 1], color='tab:blue', lw=1.5)
    axes.plot(*poses[0, :2], 'o', color='tab:blue', ms=5)


def draw_range_image(figure: Figure, axes: Axes, drive: Drive) -> None:
    """Draw the horizontal scanner's ranges, time to the right, bearing upwards."""
    scans = [t.scan for t in drive.scanners[0].stream(drive.scene.duration)]
    ranges = np.array([s.ranges for s in scans])[::max(1, len(scans) // 1200)]
    shown = axes.imshow(np.where(np.isfinite(ranges), ranges, np.nan).T, aspect='auto',
                        cmap='viridis', vmin=0.0, vmax=20.0, origin='lower',
                        extent=(0.0, drive.scene.duration, -90.0, 90.0), interpolation='nearest')
    axes.set(xlabel='time (s)', ylabel='bearing (deg)', facecolor='white', yticks=(-90, 0, 90),
             title='range image (the scanner looks left)')
    figure.colorbar(shown, ax=axes, label='range (m)')


def main() -> None:
    """Draw the scenes asked for, all by default."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('scenes', nargs='*', default=list(SCENES), metavar='SCENE')
    parser.add_argument('--seed', type=int, default=1)
    parser.add_argument('--output', type=Path, default=Path('docs/simulation'))
    args = parser.parse_args()
    args.output.mkdir(parents=True, exist_ok=True)
    vehicle = Vehicle((load_vehicle(default_vehicle_file()).horizontal,))
    for name in args.scenes:
        drive = make_drive(name, Options(seed=args.seed), vehicle=vehicle)
        path = args.output / f'{name}.png'
        draw(drive, path)
        print(f'{path}: {path.stat().st_size / 1e3:.0f} kB, {len(drive.scene.mesh)} triangles')


if __name__ == '__main__':
    main()
