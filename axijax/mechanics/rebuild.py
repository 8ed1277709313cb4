"""Contact list and membrane built again on the host, in the shapes that they have where these suffice.

A new shape is compiled anew, so lists of random packings have room to spare. `axijax.mechanics.contact_search` rebuilds
inside jit.
"""

import math
from dataclasses import replace

import numpy as np

from axijax.core.sector import Sector
from axijax.core.vector import zeros
from axijax.mechanics.contact_list import ContactList, Room, build_contact_list, carry_memory, with_mass_factor
from axijax.mechanics.dynamics import positions
from axijax.mechanics.membrane import Membrane, build_membrane
from axijax.mechanics.outer_balls import zone_found_again
from axijax.mechanics.state import State
from axijax.mechanics.tight_list import near_pairs
from axijax.specimen.specimen import Specimen

# Slots of each ball in a tight list: where none needs more; and where some do, of all balls and further ones of these.
WIDTH, FEW, FURTHER = 12, 9, 8
SPARE = 1.1  # times what is needed now: steps see the whole list, and take three times as long, where there is no room
LARGEST_OVERLAP = 0.5  # in radii of the smaller ball; deeper ones are no contacts any more


def rebuild_on_host(
    cut: Specimen, lists: tuple[ContactList, Membrane], state: State, largest_overlap: float = LARGEST_OVERLAP
):
    """Contact list and membrane built again from the current positions, and the state that goes with them (host).

    Every ball keeps its number and its image. The arrays keep their shapes where they are large enough, or else are
    made with room to spare.
    """
    network, membrane = lists
    sector = network.sector
    now = specimen_now(cut, network, membrane, state)
    now = replace(now, membrane_zone=zone_found_again(now, sector))
    skin, dtype = float(network.skin), network.dtype
    new = _list_in(network.slot.shape[0], network.first.size, now, sector, skin, largest_overlap, dtype)
    around = _membrane_in(membrane.corner.shape[1], membrane.zone.size, now, sector, dtype)
    around = replace(around, surface=membrane.surface)
    still = zeros(network.radius.shape, network.dtype)
    new = replace(new, grid=network.grid, tight=_tight_room(new, network.tight))
    if network.mass_factor is not None:
        new = with_mass_factor(new, network.mass_factor)
    return (new, around), state._replace(displacement=still, memory=carry_memory(network, new, state.memory))


def specimen_now(cut: Specimen, network: ContactList, membrane: Membrane, state: State) -> Specimen:
    """A test's balls, platens and membrane zone as they are in a state (host)."""
    bottom, top = (float(height) for height in state.platens)
    zone = np.isin(np.arange(len(cut)), np.asarray(membrane.zone))
    place = np.asarray(positions(network, state))
    return replace(cut, positions=place, bottom=bottom, top=top, membrane_zone=zone)


def roomy_lists(
    specimen: Specimen, sector: Sector, dtype=np.float64, largest_overlap: float = 0.05, denser: float = 1.0
) -> tuple[ContactList, Membrane]:
    """Contact list and membrane with room for what a random packing will become (host).

    Rooms are those of a usual dense packing where these are enough, so that specimens of a kind, loose and dense, share
    one shape, and one compiled program.

    denser: how many times as many neighbours a ball may have later; a list that outgrows its room is compiled anew [-].
    """
    count = len(specimen)
    outer = int(5 * (count * sector.order) ** (2 / 3) / sector.order) + 8
    width, contacts, tight = 18, 64 * -(-count // 10), Room(34 * -(-count // 10), WIDTH)
    network = _list_in(width, contacts, specimen, sector, None, largest_overlap, dtype)
    if denser > 1:
        now = np.asarray(network.side != 0).sum(axis=0).max()
        width = _room(int(denser * now), width, factor=1.5)
        network = _list_in(width, contacts, specimen, sector, None, largest_overlap, dtype)
    if specimen.zone_rule == "exposure":
        # A width without one to spare would soon be too small, and every step compiled again for it.
        network = replace(network, tight=_tight_room(network, tight, denser, spare=1))
    return network, _membrane_in(3 * outer + 80, outer, specimen, sector, dtype)


def _tight_room(network: ContactList, room: Room | None, denser: float = 1.0, spare: int = 0) -> Room | None:
    """Room for tight lists: what there is where it suffices, or else with some to spare; None where there is none.

    Where some balls have more contacts than WIDTH, all have slots for FEW, and those that need them further ones.
    """
    if room is None:
        return None
    contacts, slots = near_pairs(network)
    contacts = _room(int(1.05 * contacts) + 1, room.contacts, 8)
    most = int(denser * slots.max(initial=0)) + spare
    if not room.crowd:
        if most <= room.width:
            return room._replace(contacts=contacts)
        room = Room(contacts, FEW, 8 * -(-slots.size // 64), FURTHER)
    crowd = int(SPARE * denser * (slots > FEW).sum()) + 1
    return Room(contacts, FEW, _room(crowd, room.crowd, 8, 1.5), _room(most - FEW, room.further, factor=2))


def _list_in(
    width: int, contacts: int, specimen: Specimen, sector: Sector, skin, largest_overlap, dtype
) -> ContactList:
    """Contact list of this shape where it fits, or else of one with room to spare."""
    try:
        return build_contact_list(specimen, sector, skin, width, contacts, largest_overlap, dtype)
    except ValueError:  # what else may be wrong is wrong again here
        exact = build_contact_list(specimen, sector, skin, largest_overlap=largest_overlap, dtype=dtype)
        rooms = _room(exact.slot.shape[0], width, factor=1.5), _room(exact.first.size, contacts, 64)
        return build_contact_list(specimen, sector, skin, *rooms, largest_overlap, dtype)


def _membrane_in(triangles: int, balls: int, specimen: Specimen, sector: Sector, dtype) -> Membrane:
    """Membrane of this shape where it fits, or else of one with room to spare."""
    try:
        return build_membrane(specimen, sector, triangles, dtype, balls)
    except ValueError:
        exact = build_membrane(specimen, sector, dtype=dtype)
        rooms = _room(exact.corner.shape[1], triangles, 32), _room(exact.zone.size, balls, 16)
        return build_membrane(specimen, sector, rooms[0], dtype, rooms[1])


def _room(needed: int, room: int, step: int = 1, factor: float = 1.25) -> int:
    """The room there is where it is enough; or else that made larger by a factor, again and again, until some is left.

    So there are few sizes. Sizes that follow each packing would have the programs of every one of them compiled anew,
    which takes ten times as long as to pack and shear it.
    """
    if needed > room:
        while room < 1.1 * needed:
            room = step * math.ceil(factor * room / step)
    return room
