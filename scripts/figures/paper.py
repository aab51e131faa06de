"""Draw the figures of the paper that have one here.

    python scripts/figures/paper.py [--figure 2 3 4 6 8 9] [--quick]

Figure 2: level sets of the spectral radius over the gains (c_p, c_v), with one sample of delay and the device's.
3: height and force of a drop on an emulated wall, with both readings of the braking pulse. 4: the same in the phase
plane, beside the ideal analog wall. 6: a hand hits the wall several times, then presses against it. 8: the flotor is
pulled out of emulated friction by a virtual spring, beside exact Karnopp friction. 9: a smooth seeded hand moves the
flotor on all six axes in stick-slip; each axis shows a staircase.
"""

import itertools
from pathlib import Path

import numpy as np

from maglev_mj import AXES
from maglev_mj.analysis.pictures import staircases
from maglev_mj.cli.declare import Parser
from maglev_mj.cli.output import script_options
from maglev_mj.frames import Array, unit_of
from maglev_mj.pictures import SECOND, TITLE, PictureFolder, name_curves, new_figure, save
from maglev_mj.scenes.drop import Drop
from maglev_mj.scenes.press import Press
from maglev_mj.scenes.run import run_variants
from maglev_mj.scenes.stick_slip import Pull
from maglev_mj.spec import INERTIA, RANGE, Spec
from maglev_mj.studies.pictures import level_sets
from maglev_mj.theory import spectral_radius, stiffest_wall
from six_axes import run_six_axes


def figure_2(pictures: PictureFolder, quick: bool) -> Path:
    """Print and mark the maximum of c_p, as in figure 2."""
    period, mass, count = 1.0 / Spec.control_rate.value, Spec.moving_mass.value, 41 if quick else 401
    stiffest = stiffest_wall(period=period, delay=Spec.transport_delay.value, mass=mass).describe()
    head = f"Stiffest stable wall: {stiffest} with the device's delay", f"200 Hz, {mass:g} kg, no hand"
    figure, panels = new_figure(head, 1, 2, 4.2, sharex=True, sharey=True)
    cases = ("one sample of delay, eq. (6)", period), ("delay 1.5 ms, the device", Spec.transport_delay.value)
    for panel, (name, delay) in zip(panels, cases, strict=True):
        best = stiffest_wall(period=period, delay=delay, mass=mass)
        stiffness = np.linspace(1.0, 1.2 * float(best.stiffness), count)
        damping = np.linspace(0.0, 2.2 * float(best.damping), count)
        radius = spectral_radius(stiffness[:, None], damping, period=period, delay=delay, mass=mass)
        to_cp, to_cv = period**2 / (2.0 * mass), period / (2.0 * mass)
        level_sets(panel, to_cv * damping, to_cp * stiffness, radius)
        top = (to_cv * float(best.damping), to_cp * float(best.stiffness))
        panel.plot(*top, "*", color=SECOND, markersize=14, label="largest stable stiffness")
        words = {"textcoords": "offset points", "xytext": (0, 9), "ha": "center", "fontsize": 9.0}
        panel.annotate(f"$c_p$ = {top[1]:.4f}, $c_v$ = {top[0]:.4f}", top, **words)
        panel.set_xlabel("$c_v = T k_v / 2m$")
        title = f"{name}\nat most {float(best.stiffness):.0f} N/m, at {float(best.damping):.1f} N s/m"
        panel.set_title(title, **TITLE)
        print(title.replace("\n", ": "))
    print("the paper reads off figure 2: about 3900 N/m at about 60 N s/m")
    panels[0].set_ylabel("$c_p = T^2 k_p / 2m$")
    name_curves(figure, panels)
    return save(figure, pictures.path("fig2_stability"))


def figure_3(pictures: PictureFolder, _: bool) -> Path:
    """Print the figures of the drop.

    The paper's gains are the defaults: 6000 N/m, 80 N s/m, a pulse of 220 N s/m for 3 ms, 200 Hz, 1.5 ms. It prints
    neither height nor phase: the device's range, and the phase of median penetration.
    """
    variants = run_variants(Drop(force_limit=0.0).variants(), phase=0.56, phases=100, bands=Drop.band_phases)
    for label, result in variants.runs.items():
        figures = result.figures
        print(
            f"{label:>18}: {figures['penetration'] * 1e3:.2f} mm deep, rebound {figures['rebound'] * 1e3:.2f} mm, "
            f"peak {figures['peak_force']:.1f} N, settled after {figures['settling_time'] * 1e3:.0f} ms"
        )
    return Path(variants.plot(pictures.path("fig3_drop"), picture="drop_time"))


def figure_4(pictures: PictureFolder, _: bool) -> Path:
    """Take the phase of median penetration."""
    variants = run_variants(Drop(force_limit=0.0).variants(), phase=0.56, phases=100, bands=Drop.band_phases)
    return Path(variants.plot(pictures.path("fig4_phase_plane"), picture="drop_phase_plane"))


def figure_6(pictures: PictureFolder, _: bool) -> Path:
    """Take the wall's gains of figure 3; the hand, how often it hits and how hard it presses are ours."""
    variants = run_variants(Press().variants())
    for label, result in variants.runs.items():
        figures = result.figures
        depths = ", ".join(f"{depth * 1e3:.2f}" for depth in figures["penetration"])
        print(
            f"{label:>14}: hits {depths} mm deep, peak {figures['peak_force'].max():.1f} N, "
            f"pressed {figures['final_depth'] * 1e3:.3f} mm deep with {figures['final_force']:.3f} N"
        )
    return Path(variants.plot(pictures.path("fig6_press")))


def figure_8(pictures: PictureFolder, _: bool) -> Path:
    """Take the paper's values: 1000 N/m to 3 mm, 6000 N/m, 80 N s/m, 2 N, 5 mm/s, 200 Hz, 1.5 ms."""
    variants = run_variants({"rendered": Pull()})
    print(variants.table())
    return Path(variants.plot(pictures.path("fig8_stick_slip")))


def figure_9(pictures: PictureFolder, quick: bool) -> Path:
    """Print the steps of the staircases, and how far resting places are apart over seeds, phases and hands."""
    duration = 4.0 if quick else 12.0
    result = run_six_axes(duration=duration)
    print(
        f"{'axis':>6}{'slips':>8}{'still stuck at':>18}{'slips at':>12}{'breakaway / stiffness':>24}{'least step':>14}"
    )
    for index, axis in enumerate(AXES):
        stuck, gone = (bound[index] * 1e3 for bound in result.stretch)
        expected, unit = result.expected_stretch[index] * 1e3, "mm" if index < 3 else "mrad"
        least = result.steps()[index].min() * 1e3
        print(f"{axis:>6}{result.slips[index]:>8}{stuck:>18.4f}{gone:>12.4f}{expected:>24.4f}{least:>14.2f} {unit}")
    # what a hand can place: a step of a rotation is taken at the radius of gyration
    radius = np.sqrt(np.array(INERTIA) / INERTIA[0])
    seeds, phases = ((1,), (0.0,)) if quick else (range(1, 9), (0.0, 0.25, 0.5, 0.75))
    print(
        "distance from one resting place to the next, exact plant [mm], "
        "on each axis that stays within the device's range"
    )
    print(f"{'hand':>10}{'steps':>8}{'least':>8}{'5 %':>8}{'median':>8}   axes")
    for stiffness in (1500.0,) if quick else (1000.0, 1500.0, 2500.0):
        distances: list[Array] = []
        tried = 0
        for seed, phase in itertools.product(seeds, phases):
            run = run_six_axes(plant="exact", seed=seed, phase=phase, hand_stiffness=stiffness, duration=duration)
            inside = np.abs(run.position).max(axis=0) <= RANGE
            distances += [
                one * scale * 1e3 for one, scale, kept in zip(run.steps(), radius, inside, strict=True) if kept
            ]
            tried += len(AXES)
        low, fifth, middle = np.percentile(np.concatenate(distances), [0.0, 5.0, 50.0])
        count = sum(map(len, distances))
        print(f"{stiffness:>6.0f} N/m{count:>8}{low:>8.2f}{fifth:>8.2f}{middle:>8.2f}   {len(distances)} of {tried}")
    labels = {}
    for index, steps in enumerate(result.steps()):
        span = f"{steps.min() * 1e3:.2g} to {steps.max() * 1e3:.2g} {unit_of('mm', index)}" if steps.size else ""
        between = f", resting places {span} apart" if span else ""
        labels[index] = f"{int(result.slips[index])} slips{between}"
    anchors = np.where(result.stuck, result.anchor, np.nan)
    least = min(steps.min() for steps in result.steps()[:3] if steps.size) * 1e3
    head = [f"{result.slips.sum()} slips in {duration:g} s; resting places at least {least:.2g} mm apart"]
    head += ["a smooth hand on six axes in stick-slip, 200 Hz, delay 1.5 ms, 6000 N/m, 80 N s/m, breakaway 2 N"]
    return save(staircases(head, result.time, result.position, anchors, labels), pictures.path("fig9_six_axes"))


FIGURES = {"2": figure_2, "3": figure_3, "4": figure_4, "6": figure_6, "8": figure_8, "9": figure_9}


def add_options(parser: Parser) -> None:
    """Add the choice of figures."""
    parser.add_argument(
        "--figure", nargs="+", choices=FIGURES, default=list(FIGURES), metavar="N", help="of the paper; all by default"
    )


if __name__ == "__main__":
    options = script_options(__doc__, "coarser figures 2 and 9", add_options)
    for name in options.figure:
        print("wrote", FIGURES[name](options.pictures, options.quick))
