"""Random specimens: balls of a grading placed at random in a sector, grown, compacted, and turned into a full cylinder.

1. Radii by quantiles of the grading, so that the grading is met as well as so many balls can.
2. Centres and sizes from a Halton sequence, scrambled by the seed, so that every part of the sector gets its share of
   balls and of sizes; small balls grow to their size while overlaps, images included, are pushed apart.
3. Contraction of the cloud as a whole until balls and platens bear on one another, see `axijax.triaxial.compaction`.
4. Compaction by membrane and platens at the confining stress, with a friction that decides how dense the packing
   becomes: 0.05 gives a dense one, 0.5 nearly the loosest.

The last is the triaxial test's own confinement.
"""

import itertools
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from axijax import theory
from axijax.core.bars import telling
from axijax.core.platform import require_64_bits
from axijax.core.sector import Sector, plane_normals
from axijax.core.vector import from_rows
from axijax.mechanics.contact_list import with_mass_factor
from axijax.mechanics.contacts import geometry
from axijax.mechanics.dynamics import Scene, all_forces, positions
from axijax.mechanics.hertz import Hertz
from axijax.mechanics.linear import Linear
from axijax.mechanics.membrane import Load, build_membrane, membrane_radius
from axijax.mechanics.outer_balls import outer_balls
from axijax.mechanics.params import Params, check_params
from axijax.mechanics.rebuild import roomy_lists
from axijax.mechanics.time_step import DEFAULT_STEP
from axijax.mechanics.volume import void_ratio as below_skin
from axijax.specimen.fabric import contact_statistics, inside_balls, measured, pairs_within, sample_points
from axijax.specimen.grading import Grading, linear
from axijax.specimen.specimen import Specimen, check_positive
from axijax.triaxial.compaction import Compaction, Contraction
from axijax.triaxial.density import SEEDS, bounds, library, sought
from axijax.triaxial.feasible import check_feasible
from axijax.triaxial.packing_report import PackingReport
from axijax.triaxial.stages import settle
from axijax.triaxial.uniformity import core_stress, trends

BEYOND = 1.5  # mean radii by which the balls reach beyond Rm, once compacted
LIGHTEST = 0.75  # radius of the ball that is as heavy as the lightest in compaction, over that of the mean volume
DENSER = 1.7  # times the neighbours that a large ball among small ones has at the loose start, it has once compacted
STIFFEST = 3e-4  # softness s3 r/kn down to which compaction takes the stiffness of Hertzian balls
# Radius of the core that no ball can reach, over the cloud's, above which it cannot contract alike in all directions.
HOLLOW = 0.25


def random_cylinder(
    balls: int = 2000,
    sector: Sector = Sector(1),  # noqa: B008 (frozen)
    grading: Grading | None = None,
    aspect_ratio: float = 2.0,
    compaction_friction: float = 0.05,
    void_ratio: float | None = None,
    relative_density: float | None = None,
    void_ratio_tolerance: float = 0.005,
    seed: int = 0,
    params: Params | None = None,
    tolerance: float = 1e-3,
    most_steps: int = 100_000,
    progress: Callable[[str], None] | bool = False,
) -> tuple[Specimen, PackingReport]:
    """A full cylinder of balls packed at random with the sector's symmetry, in balance at the confining stress.

    `TriaxialTest(specimen, sector, confining_friction=report.compaction_friction)` shears it.

    balls: in the full cylinder; a sector of order n holds balls/n.
    sector: of whose n rotations the specimen is made; between rigid planes it is compacted against them.
    grading: of the balls; None takes radii spread evenly from 16 to 24 [L].
    aspect_ratio: height over 2 Rm, met to some 10 % [-].
    compaction_friction: between balls during compaction: 0.05 dense, 0.5 loose [-]. With none at all a packing is a
        little denser, but cannot bear the least difference between membrane and platens, and may never settle.
    void_ratio: sought instead, by adjusting the compaction friction, to within void_ratio_tolerance; the one below the
        skin, `PackingReport.counted_void_ratio` [-].
    relative_density: sought instead, 0 to 1 between the loosest and the densest packing of this grading, at this size
        and confining stress, of seed 0; these are found once and kept, see `axijax.triaxial.density` [-].
    seed: of the random numbers; the same seed gives the same specimen to the last bit.
    params: stiffnesses, confining stress and density; None takes the defaults. Compaction has linear springs whatever
        the law of the test: for Hertzian balls springs that these press in as deeply at the confining stress, or as
        stiff as softness STIFFEST says, since with those of glass compaction would take twenty times as many steps.
    tolerance: unbalanced force and stress error at which compaction ends [-]. most_steps: allowed for it.
    progress: True for a line in the terminal or the notebook, or a function that is called with what goes on.

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
    if void_ratio is not None and relative_density is not None:
        raise ValueError(
            f"void_ratio = {void_ratio:g} and relative_density = {relative_density:g}: give one of them only."
        )
    if relative_density is not None and not 0 <= relative_density <= 1:
        raise ValueError(f"relative_density = {relative_density!r}: must lie between 0 (loosest) and 1 (densest) [-].")
    radii = grading.sample(balls // sector.order)
    if not hasattr(params, "normal_stiffness"):
        params = replace(params, material=_springs(params, radii))
    told = check_feasible(grading, radii, params, balls)

    trials = itertools.count(1)

    def compacted(friction: float, seed: int = seed) -> tuple[Specimen, PackingReport]:
        tell(f"packing {balls} balls at random, number {next(trials)}, friction {friction:.3g}")
        rng = np.random.default_rng(seed)
        # Near to what compaction will reach, so that it hardly changes the shape.
        loose = _grown(radii, sector, aspect_ratio, 0.6 - 0.1 * friction / (friction + 0.15), rng)
        path = Compaction(float(friction) or None, tolerance, most_steps)
        cut, report = _compacted(loose, sector, params, path)
        known = {"fractions": grading.fractions(radii), "warnings": told, "sieves": _sieves(grading, radii)}
        return cut, replace(report, grading=grading.name, seed=seed, **known)

    with telling(progress) as tell:
        if relative_density is not None:
            made_from = [balls, sector, list(grading.radii), list(grading.share), aspect_ratio, params, tolerance]
            known = bounds(partial(compacted, seed=0), made_from, library())
            wanted, said = known.void_ratio(relative_density), f"relative_density = {relative_density:g}"
            cut, report = sought(compacted, wanted, void_ratio_tolerance, f"{said}, void ratio {wanted:.4f}", SEEDS)
            report = replace(report, bounds=known)
        elif void_ratio is not None:
            cut, report = sought(compacted, void_ratio, void_ratio_tolerance, f"void_ratio = {void_ratio:g}")
        else:
            cut, report = compacted(compaction_friction)
    return _whole_cylinder(cut, sector), report


def platen_speed(inertial_number: float, specimen: Specimen, params: Params) -> float:
    """Speed of each platen for an inertial number, see `theory.inertial_number`, with the mean radius [L/T]."""
    check_positive("inertial_number", inertial_number)
    of_unit_rate = theory.inertial_number(1.0, specimen.radius.mean(), params.density, params.confining_stress)
    return float(inertial_number / of_unit_rate * specimen.height / 2)


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
    order = _neighbours_together(place, radius.mean())
    place, height, radius = apart * place[:, order], apart * height, radius[order]
    zone = outer_balls(place, radius, 0.0, height, sector)
    return Specimen(place, radius, 0.0, height, zone, "random cylinder", "exposure")


def _neighbours_together(place: np.ndarray, mean: float) -> np.ndarray:
    """An order of the balls, layer by layer and row by row, in which a step finds its neighbours in the processor's
    cache; (N,) int. mean: of the radii [L]."""
    layer, row = (np.floor(part / (2.5 * mean)) for part in (place[2], place[1]))
    return np.lexsort((place[0], row, layer))


def _compacted(loose: Specimen, sector: Sector, params: Params, path: Compaction):
    """A sector's balls in balance at the confining stress, and the report of it but for grading and seed."""
    mixed = loose.radius.max() > 2 * loose.radius.min()
    network, membrane = roomy_lists(loose, sector, denser=DENSER if mixed else 1.0)
    inertia, least = _inertia(loose.radius)
    lists = with_mass_factor(network, inertia), membrane
    mass = float(params.density) * (4 / 3) * np.pi * least**3
    # The limit of twelve contacts a ball, which no ball of the smallest size exceeds (PHYSICS 3.5).
    dt = float(DEFAULT_STEP * np.sqrt(mass / (10 * max(float(params.normal_stiffness), float(params.shear_stiffness)))))
    wide, state, begun = (np.hypot(*loose.positions[:2]) + loose.radius).max(), None, 0
    if _hollow(loose.radius.mean(), sector) < HOLLOW * wide:
        together = Contraction(path.friction, path.tolerance, path.most_steps, wide / loose.height)
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
    contacts, whole = contact_statistics(cut, sector), _void_ratio(cut, sector, rm, bottom, top)
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
        void_ratio=whole,
        counted_void_ratio=_counted(cut, sector) or whole,
        bounds=None,
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


def _counted(cut: Specimen, sector: Sector) -> float | None:
    """Void ratio below the skin, None where the specimen has no inside."""
    found = jax.jit(below_skin, static_argnums=3)(
        from_rows(cut.positions), jnp.asarray(cut.radius), jnp.ones(len(cut)), sector, jnp.array([cut.bottom, cut.top])
    )
    return float(found) if found > 0 else None


def _springs(params: Params, radii: np.ndarray) -> Linear:
    """Linear springs for the compaction of balls of another law."""
    if not isinstance(params.material, Hertz):
        return Linear(density=params.density)
    stress, mean = float(params.confining_stress), radii.mean()
    # Mean force of a contact where each ball has five of them, see `hertz.confined_force`; a Hertzian contact is 2/3 as
    # stiff over all of its overlap as at the end of it.
    tangent = params.material.tangent_stiffness(mean / 2, 4.1 * stress * mean**2)
    normal, shear = ((2 / 3) * float(k) for k in tangent)
    less = min(1.0, stress * mean / STIFFEST / normal)
    return Linear(density=params.density, normal_stiffness=less * normal, shear_stiffness=less * shear)


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
