"""Random specimens: balls of a grading placed at random in a sector, grown, compacted, and turned into a full cylinder.

1. Radii by quantiles of the grading, so that the grading is met as well as so many balls can.
2. Centres and sizes from a Halton sequence, scrambled by the seed, so that every part of the sector gets its share of
   balls and of sizes; small balls grow to their size while overlaps, images included, are pushed apart.
3. Contraction of the cloud as a whole until balls and platens bear on one another, see `axijax.triaxial.compaction`.
4. Compaction by membrane and platens at the confining stress, with a friction that decides how dense the packing
   becomes: 0.05 gives a dense one, 0.5 nearly the loosest.

The last is the triaxial test's own confinement.
"""

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np

from axijax import theory
from axijax.core.platform import require_64_bits
from axijax.core.sector import Sector, plane_normals
from axijax.core.vector import from_rows
from axijax.mechanics.contacts import geometry
from axijax.mechanics.dynamics import Scene, all_forces, positions
from axijax.mechanics.linear import Linear
from axijax.mechanics.membrane import Load, build_membrane, membrane_radius
from axijax.mechanics.outer_balls import outer_balls
from axijax.mechanics.params import Params, check_params
from axijax.mechanics.rebuild import roomy_lists
from axijax.mechanics.time_step import DEFAULT_STEP
from axijax.specimen.fabric import contact_statistics, inside_balls, measured, pairs_within, sample_points
from axijax.specimen.grading import Fraction, Grading, linear
from axijax.specimen.specimen import Specimen, check_positive
from axijax.triaxial.compaction import Contraction
from axijax.triaxial.feasible import check_feasible
from axijax.triaxial.paths import Isotropic
from axijax.triaxial.stages import settle
from axijax.triaxial.uniformity import core_stress, trends

BEYOND = 1.5  # mean radii by which the balls reach beyond Rm, once compacted
LIGHTEST = 0.75  # radius of the ball that is as heavy as the lightest in compaction, over that of the mean volume
# Radius of the core that no ball can reach, over the cloud's, above which it cannot contract alike in all directions.
HOLLOW = 0.25
DENSEST, LOOSEST = 0.02, 0.5  # compaction frictions between which a void ratio is sought


@dataclass(frozen=True)
class PackingReport:
    """What a generated specimen has become; `print(report)` says it in words.

    balls: in the full cylinder. grading: what was asked for. radii: (N,) of the sector's balls, rising [L].
    sieves: (S, 3) radius [L], per cent passing by mass wanted and reached.
    fractions: what each fraction of the grading was to have, and got; empty where it has none.
    warnings: sentences.
    membrane_radius: Rm, through the middle of the membrane zone; height: between the platens [L].
    void_ratio: volume not in balls over volume in balls, in the cylinder of radius Rm between the platens (volume
        pi Rm^2 H; of a ball that it cuts, the part inside) [-].
    core_void_ratio: the same within Rm/2 and the middle 60 % of the height [-].
    core_stress_ratio, core_contacts, core_stress_error: of that core, see `uniformity.CoreStress`.
    void_ratio_trend, size_trend, size_trend_error: (2,) along radius and height, see `uniformity.Trends` [-].
    coordination_number, mechanical_coordination_number, rattler_fraction, anisotropy: see `fabric.Contacts` [-].
    compaction_friction: with which it was compacted [-].
    unbalanced_force, stress_error: how well it is balanced, as at the end of a confinement [-].
    steps: of the compaction. seed: of the random numbers.
    """

    balls: int
    order: int
    grading: str
    radii: np.ndarray
    sieves: np.ndarray
    fractions: list[Fraction]
    warnings: list[str]
    membrane_radius: float
    height: float
    void_ratio: float
    core_void_ratio: float
    core_stress_ratio: float
    core_contacts: int
    core_stress_error: float
    void_ratio_trend: tuple[float, float]
    size_trend: tuple[float, float]
    size_trend_error: tuple[float, float]
    coordination_number: float
    mechanical_coordination_number: float
    rattler_fraction: float
    anisotropy: float
    compaction_friction: float
    unbalanced_force: float
    stress_error: float
    steps: int
    seed: int

    @property
    def deviation(self) -> float | None:
        """By how much of the whole mass the worst fraction misses what was asked for; None without fractions [-]."""
        return max((abs(each.got - each.wanted) for each in self.fractions), default=None)

    def __str__(self) -> str:
        sieves = "  ".join(f"{radius:.4g}: {wanted:.0f}/{got:.1f}" for radius, wanted, got in self.sieves)
        return "\n".join(
            [
                f"random specimen, seed {self.seed}: {self.balls} balls, {self.radii.size} in a sector of order "
                f"{self.order}",
                f"  grading          {self.grading}; radius: % passing by mass, wanted/reached  {sieves}",
                f"  size             Rm {self.membrane_radius:.4g}, H {self.height:.4g}, H/D "
                f"{self.height / 2 / self.membrane_radius:.3f}",
                f"  void ratio       {self.void_ratio:.4f} in pi Rm^2 H, {self.core_void_ratio:.4f} in the inner core",
                f"  core             stress ratio {self.core_stress_ratio:.3f}, vertical over horizontal; 1 +- "
                f"{self.core_stress_error:.3f} expected of {self.core_contacts} contacts",
                f"  uniformity       void ratio {self.void_ratio_trend[0]:+.3f} outer less inner half, "
                f"{self.void_ratio_trend[1]:+.3f} middle less ends; size {100 * self.size_trend[0]:+.1f} +- "
                f"{100 * self.size_trend_error[0]:.1f} %, {100 * self.size_trend[1]:+.1f} +- "
                f"{100 * self.size_trend_error[1]:.1f} %",
                f"  coordination     {self.coordination_number:.3f}, mechanical "
                f"{self.mechanical_coordination_number:.3f}, rattlers {100 * self.rattler_fraction:.1f} %",
                f"  fabric           vertical minus horizontal {self.anisotropy:+.4f}",
                f"  compaction       friction {self.compaction_friction:.4g}, {self.steps} steps, unbalanced force "
                f"{self.unbalanced_force:.1e}, stress error {self.stress_error:.1e}",
                *(f"  warning          {text}" for text in self.warnings),
            ]
        )


def random_cylinder(
    balls: int = 2000,
    sector: Sector = Sector(1),  # noqa: B008 (frozen)
    grading: Grading | None = None,
    aspect_ratio: float = 2.0,
    compaction_friction: float = 0.05,
    void_ratio: float | None = None,
    void_ratio_tolerance: float = 0.005,
    seed: int = 0,
    params: Params | None = None,
    tolerance: float = 1e-3,
    most_steps: int = 100_000,
) -> tuple[Specimen, PackingReport]:
    """A full cylinder of balls packed at random with the sector's symmetry, in balance at the confining stress.

    `TriaxialTest(specimen, sector, confining_friction=report.compaction_friction)` shears it.

    balls: in the full cylinder; a sector of order n holds balls/n.
    sector: of whose n rotations the specimen is made; between rigid planes it is compacted against them.
    grading: of the balls; None takes radii spread evenly from 16 to 24 [L].
    aspect_ratio: height over 2 Rm, met to some 10 % [-].
    compaction_friction: between balls during compaction: 0.05 dense, 0.5 loose [-]. With none at all a packing is a
        little denser, but cannot bear the least difference between membrane and platens, and may never settle.
    void_ratio: sought instead, by adjusting the compaction friction, to within void_ratio_tolerance [-].
    seed: of the random numbers; the same seed gives the same specimen to the last bit.
    params: stiffnesses, confining stress and density; None takes the defaults. Compaction has linear springs whatever
        the law of the test, whose own confinement settles a Hertzian specimen: with the stiffness of glass compaction
        would take twenty times as many steps.
    tolerance: unbalanced force and stress error at which compaction ends [-]. most_steps: allowed for it.

    Raises ValueError for arguments that make no sense or are not supported (a fraction of the grading that gets no
    ball, sizes too wide apart, contacts too soft: see `axijax.triaxial.feasible`), and for a void ratio that cannot be
    reached, with the range that can; RuntimeError where compaction did not reach its tolerance. Warns where the balls
    miss the mass of a fraction by more than `grading.WELL_MET` of the whole.
    """
    require_64_bits()
    grading = linear(16.0, 24.0) if grading is None else grading
    params = Params() if params is None else params
    if isinstance(balls, bool) or not isinstance(balls, int | np.integer) or balls < 1 or balls % sector.order:
        raise ValueError(
            f"balls = {balls!r}: must be a whole multiple of the sector's order {sector.order}, as each sector holds "
            "the same number."
        )
    if balls // sector.order < 10:
        raise ValueError(f"balls = {balls}: a sector of order {sector.order} needs at least {10 * sector.order}.")
    check_positive("aspect_ratio", aspect_ratio)
    check_positive("tolerance", tolerance)
    check_positive("void_ratio_tolerance", void_ratio_tolerance)
    if not (np.isfinite(compaction_friction) and 0 <= compaction_friction <= 1):
        raise ValueError(f"compaction_friction = {compaction_friction!r}: must lie between 0 (dense) and 1 [-].")
    if void_ratio is not None:
        check_positive("void_ratio", void_ratio)
    check_params(params, balls // sector.order)
    if not hasattr(params, "normal_stiffness"):
        params = replace(params, material=Linear(density=params.density))
    radii = grading.sample(balls // sector.order)
    told = check_feasible(grading, radii, params, balls)

    def compacted(friction: float) -> tuple[Specimen, PackingReport]:
        rng = np.random.default_rng(seed)
        # Near to what compaction will reach, so that it hardly changes the shape.
        loose = _grown(radii, sector, aspect_ratio, 0.6 - 0.1 * friction / (friction + 0.15), rng)
        path = Isotropic(float(friction) or None, tolerance, most_steps)
        cut, report = _compacted(loose, sector, params, path)
        known = {"fractions": grading.fractions(radii), "warnings": told, "sieves": _sieves(grading, radii)}
        return cut, replace(report, grading=grading.name, seed=seed, **known)

    if void_ratio is None:
        cut, report = compacted(compaction_friction)
    else:
        cut, report = _sought(compacted, void_ratio, void_ratio_tolerance)
    return _whole_cylinder(cut, sector), report


def platen_speed(inertial_number: float, specimen: Specimen, params: Params) -> float:
    """Speed of each platen for an inertial number, see `theory.inertial_number`, with the mean radius [L/T]."""
    check_positive("inertial_number", inertial_number)
    of_unit_rate = theory.inertial_number(1.0, specimen.radius.mean(), params.density, params.confining_stress)
    return float(inertial_number / of_unit_rate * specimen.height / 2)


def _sought(compacted, void_ratio: float, tolerance: float):
    """A packing of this void ratio: regula falsi in the compaction friction, which the void ratio rises with."""
    low, high = DENSEST, LOOSEST
    ends = compacted(low), compacted(high)
    below, above = (report.void_ratio for _, report in ends)
    if not below - tolerance <= void_ratio <= above + tolerance:
        raise ValueError(
            f"void_ratio = {void_ratio:g}: this grading, size and seed reach {below:.4f} (compaction friction {low:g}) "
            f"to {above:.4f} ({high:g}); ask for one between."
        )
    best = min(ends, key=lambda end: abs(end[1].void_ratio - void_ratio))
    for trial in range(10):
        if abs(best[1].void_ratio - void_ratio) <= tolerance:
            return best
        # The rise is steep at small frictions: every second trial halves the interval.
        weight = 0.5 if trial % 2 else np.clip((void_ratio - below) / max(above - below, 1e-12), 0.1, 0.9)
        friction = low + weight * (high - low)
        now = compacted(friction)
        if now[1].void_ratio < void_ratio:
            low, below = friction, now[1].void_ratio
        else:
            high, above = friction, now[1].void_ratio
        best = min((best, now), key=lambda end: abs(end[1].void_ratio - void_ratio))
    raise ValueError(
        f"void_ratio = {void_ratio:g}: the nearest that was reached in 12 compactions is {best[1].void_ratio:.4f}; "
        f"allow a void_ratio_tolerance above {abs(best[1].void_ratio - void_ratio):.4f}, or take another seed."
    )


def _hollow(mean: float, sector: Sector) -> float:
    """Radius of the core that no ball between close planes can reach [L]; mean: of the balls' radii."""
    return 0.8 * max(mean / np.sin(np.pi / sector.order) - mean, 0.0) if sector.order > 2 else 0.0


def _container(radius: np.ndarray, sector: Sector, aspect_ratio: float, solid_fraction: float):
    """Radius and height of a cylinder that these balls fill to a solid fraction [L].

    Counted without the looser layer along walls, and the core that no ball between close planes can reach.
    """
    solid, mean = sector.order * (4 / 3) * np.pi * (radius**3).sum(), radius.mean()
    core = _hollow(mean, sector)
    side = 1.5 * (solid / (2 * np.pi * aspect_ratio * solid_fraction)) ** (1 / 3) + core + 2 * mean
    for _ in range(100):
        height = 2 * aspect_ratio * (side - BEYOND * mean)
        room = np.pi * ((side - 0.3 * mean) ** 2 - core**2) * (height - 0.6 * mean)
        side *= (solid / solid_fraction / room) ** (1 / 3)
    return side, height


def _grown(radius: np.ndarray, sector: Sector, aspect_ratio: float, solid_fraction: float, rng) -> Specimen:
    """Balls of these radii in a sector without overlaps, images included, at a solid fraction or the nearest below.

    Centres at random, radii growing from nothing; overlaps are pushed apart, half by either ball.
    """
    from scipy.stats import qmc  # takes long to import

    side, height = _container(radius, sector, aspect_ratio, solid_fraction)
    count = radius.size
    # Independent numbers would leave regions of balls that are few, or small, and pushing apart does not reach far.
    *u, size = qmc.Halton(4, rng=rng).random(count).T
    radius = np.sort(radius)[size.argsort().argsort()]
    rho, theta = side * np.sqrt(u[0]), sector.angle * u[1]
    place = np.stack([rho * np.cos(theta), rho * np.sin(theta), height * u[2]])

    def held(place, size):
        """Within the container."""
        if sector.boundary == "rigid":
            for normal in plane_normals(sector):
                inside = normal @ place[:2] - size
                place[:2] -= normal[:, None] * np.minimum(inside, 0.0)
        rho = np.hypot(place[0], place[1])
        place[:2] *= np.minimum(1.0, (side - size) / np.maximum(rho, 1e-9 * side))
        place[2] = np.clip(place[2], size, height - size)
        return place

    skin = 0.6 * radius.mean()
    pairs, listed, sized = None, place, radius
    for growth in np.concatenate([np.linspace(0.4, 1.0, 150), np.ones(450)]):
        size = growth * radius
        if pairs is None or 2 * np.sqrt(((place - listed) ** 2).sum(0).max()) + 2 * (size - sized).max() > skin:
            pairs, listed, sized = pairs_within(place, size, sector, skin), place.copy(), size
        now = measured(pairs, place, size, sector)
        overlap = np.maximum(now.overlap, 0.0)
        if growth == 1 and (overlap < 0.01 * radius.min()).all():
            break
        push = now.apart * (0.5 * overlap / np.maximum(size[now.first] + size[now.second] - now.overlap, 1e-12))
        place = held(place + np.stack([np.bincount(now.first, row, count) for row in push]), size)
    # What is left of overlaps is taken out by moving everything apart.
    now = pairs_within(place, radius, sector)
    touching = (radius[now.first] + radius[now.second]) / np.sqrt((now.apart**2).sum(0))
    apart = max(1.0, touching.max(initial=1.0)) * (1 + 1e-9)
    place, height = apart * place, apart * height
    zone = outer_balls(place, radius, 0.0, height, sector)
    return Specimen(place, radius, 0.0, height, zone, "random cylinder", "exposure")


def _compacted(loose: Specimen, sector: Sector, params: Params, path: Isotropic):
    """A sector's balls in balance at the confining stress, and the report of it but for grading and seed."""
    lists = roomy_lists(loose, sector)
    inertia, least = _inertia(loose.radius)
    path = replace(path, inertia=inertia)
    mass = float(params.density) * (4 / 3) * np.pi * least**3
    # The limit of twelve contacts a ball, which no ball of the smallest size exceeds (PHYSICS 3.5).
    dt = float(DEFAULT_STEP * np.sqrt(mass / (10 * max(float(params.normal_stiffness), float(params.shear_stiffness)))))
    wide, state, begun = (np.hypot(*loose.positions[:2]) + loose.radius).max(), None, 0
    if _hollow(loose.radius.mean(), sector) < HOLLOW * wide:
        together = Contraction(path.friction, path.tolerance, path.most_steps, inertia, wide / loose.height)
        lists, state, contracted = settle(Scene(), together, loose, lists, dt, params)
        state, begun = state._replace(memory=state.memory[:-1]), int(contracted.steps)  # the container has no memory
    (network, membrane), state, balance = settle(Scene(), path, loose, lists, dt, params, start=state)
    balance = balance._replace(steps=begun + balance.steps)
    if not float(balance.worst) <= path.tolerance:
        raise RuntimeError(
            f"compaction of the random specimen stopped after {int(balance.steps)} steps at an unbalanced force of "
            f"{float(balance.unbalanced_force):.2g} and a stress error of {float(balance.stress_error):.2g}: raise "
            f"most_steps or the tolerance {path.tolerance:g}."
        )
    place = np.asarray(positions(network, state))
    bottom, top = (float(platen) for platen in state.platens)
    cut = replace(
        loose,
        positions=place,
        bottom=bottom,
        top=top,
        membrane_zone=outer_balls(place, loose.radius, bottom, top, sector),
    )
    rm = float(membrane_radius(build_membrane(cut, sector), from_rows(place)))
    middle, height = (top + bottom) / 2, top - bottom
    contacts = contact_statistics(cut, sector)
    trend = trends(cut, sector, rm)
    at_rest = path.params(params, network, membrane, state.platens)
    forces = all_forces(path.scene(Scene()), at_rest, network, Load(jnp.zeros(len(cut)), jnp.ones(())), dt, state)
    branch = geometry(network, state.displacement).branch
    normal = branch * (1 / jnp.sqrt(branch.dot(branch)))
    stress = core_stress(network, forces.contacts.force, normal, from_rows(place), rm, state.platens)
    report = PackingReport(
        balls=len(cut) * sector.order,
        order=sector.order,
        grading="",
        radii=np.sort(cut.radius),
        sieves=np.zeros((0, 3)),
        fractions=[],
        warnings=[],
        membrane_radius=rm,
        height=height,
        void_ratio=_void_ratio(cut, sector, rm, bottom, top),
        core_void_ratio=_void_ratio(cut, sector, rm / 2, middle - 0.3 * height, middle + 0.3 * height),
        core_stress_ratio=stress.ratio,
        core_contacts=stress.contacts,
        core_stress_error=stress.error,
        void_ratio_trend=trend.void_ratio,
        size_trend=trend.size,
        size_trend_error=trend.size_error,
        **contacts._asdict(),
        compaction_friction=float(path.friction or 0.0),
        unbalanced_force=float(balance.unbalanced_force),
        stress_error=float(balance.stress_error),
        steps=int(balance.steps),
        seed=0,
    )
    return cut, report


def _inertia(radius: np.ndarray) -> tuple[jax.Array | None, float]:
    """By what the balls' masses are multiplied, (N,) or None where none is, and the radius of a ball whose mass the
    smallest then have [L].

    What compaction ends in knows no masses; but the lightest set the time step, fly fastest where the membrane drives
    them into a pore, and rattle longest. So no ball is lighter than LIGHTEST says; and of a larger ball
    the mass grows with its surface, that is with the number of smallest balls that it may touch.
    """
    least = max(LIGHTEST * (radius**3).mean() ** (1 / 3), radius.min())
    wanted = least**3 * ((1 + radius / radius.min()) / 2) ** 2
    inertia = np.maximum(wanted / radius**3, 1.0)
    return (jnp.asarray(inertia) if inertia.max() > 1 else None), least


def _void_ratio(cut: Specimen, sector: Sector, radius: float, bottom: float, top: float) -> float:
    """Infinite where there is no ball, as in the core of a narrow sector of few balls."""
    solid = float(inside_balls(sample_points(sector, radius, bottom, top), cut, sector).mean())
    return (1 - solid) / solid if solid > 0 else np.inf


def _sieves(grading: Grading, radius: np.ndarray) -> np.ndarray:
    """Radius, per cent passing by mass wanted and reached, at five points of the grading; (5, 3)."""
    fine = grading.sample(20_000)
    at = np.interp([0.1, 0.3, 0.5, 0.7, 0.9], np.cumsum(fine**3) / (fine**3).sum(), fine)

    def passing(radii):
        return 100 * (radii**3 * (radii <= at[:, None] * (1 + 1e-12))).sum(1) / (radii**3).sum()

    return np.stack([at, passing(fine), passing(radius)], axis=1)


def _whole_cylinder(cut: Specimen, sector: Sector) -> Specimen:
    """The sector's balls and their n rotations."""
    turns = np.repeat(np.arange(sector.order), len(cut))
    copies = np.tile(np.arange(len(cut)), sector.order)
    home = cut.positions
    if sector.boundary == "periodic":
        home = sector.rotate(home, sector.home_image(home))
    return replace(
        cut,
        positions=sector.rotate(home[:, copies], turns),
        radius=cut.radius[copies],
        membrane_zone=cut.membrane_zone[copies],
        name=f"random cylinder, {copies.size} balls",
    )
