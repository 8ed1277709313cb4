"""Status bits: what only a run itself can see go wrong, and the sentence for each."""

# Bits of the status code that a run carries; `curve.raise_for_status` turns them into sentences.
NOT_FINITE, NOT_CONFINED, STALE_LIST, STALE_CELLS, ESCAPED, UNSTABLE, FULL_LIST = 1, 2, 4, 8, 16, 32, 256
SENSELESS, UNFINISHED, UNFOLLOWED = 64, 128, 512

REMEDIES = {
    SENSELESS: (
        "a parameter is negative, or zero where it must be positive (stiffnesses, stress, density, platen speed): such "
        "a test does not exist"
    ),
    NOT_FINITE: "a position is no longer finite: the run is unstable; lower time_step or check the parameters",
    NOT_CONFINED: "confinement did not reach the stated equilibrium; raise confine_steps or the tolerance",
    STALE_LIST: (
        "two balls together moved by more than the skin of the contact list, so a contact may be missing: "
        "lower platen_speed or axial_strain, or make the list anew with `run` or rebuild_every"
    ),
    STALE_CELLS: (
        "the membrane's balls moved past one another: lower platen_speed or axial_strain, or make its cells anew with "
        "`run` or rebuild_every"
    ),
    FULL_LIST: (
        "a ball has more neighbours, or the membrane more balls, than a list that is made anew inside `simulate` has "
        "room for; use `run`, which makes room, or stop at a smaller axial_strain"
    ),
    UNFOLLOWED: (
        "the specimen could not follow a stage to its end: its lateral or axial stress has fallen to nothing, or what "
        "is asked for is outside its strength; the last records are those of where it stopped"
    ),
    UNFINISHED: (
        "a stage had not reached its end when its records were used up: give it a longer time or a nearer "
        "axial_strain, or use `run`, which goes on for as long as it takes"
    ),
    ESCAPED: "a ball has left the membrane or passed a platen; lower time_step or stop at a smaller axial_strain",
    UNSTABLE: (
        "contacts chatter from step to step at the peak of the stress ratio, which is then wrong: the time step is too "
        "long for these parameters; lower time_step"
    ),
}


def described(status: int) -> str:
    """What status bits say went wrong and what to do, without a full stop; empty where they are all zero."""
    if status & NOT_FINITE:  # of which all others are consequences
        status = NOT_FINITE
    unknown = status & ~sum(REMEDIES)
    told = [text for bit, text in REMEDIES.items() if status & bit]
    return "; ".join([*told, f"for a reason that this program does not know, status {unknown}"] if unknown else told)
