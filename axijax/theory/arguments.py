"""Whether the arguments of a closed form are in its range; arrays and traced values are never checked."""

# Arguments that must be greater than 0; the others may be 0.
_POSITIVE = {"angular_frequency", "contact_elevation", "contacts_per_ball", "effective_mass", "mass"}
_POSITIVE |= {"effective_modulus", "normal_stiffness", "radius", "reduced_radius", "stiffness", "stiffness_factor"}
_POSITIVE |= {"confining_stress", "density", "tan_angle"}


def are_numbers(*values):
    return all(isinstance(value, (int, float)) for value in values)


def require(name, value, low=0.0, below=float("inf")):
    if are_numbers(value, low, below) and not low <= value < below:
        upper = f" < {below:.6g}" if below < float("inf") else ""
        raise ValueError(f"{name} is {value}, but this formula needs {low:.6g} <= {name}{upper}.")


def require_positive(name, value):
    if are_numbers(value) and not value > 0:
        raise ValueError(f"{name} is {value}, but this formula needs {name} > 0.")


def check_signs(**arguments):
    for name, value in arguments.items():
        (require_positive if name in _POSITIVE else require)(name, value)


def look_up(table, lattice):
    if lattice not in table:
        raise ValueError(f"lattice is {lattice!r}, but it must be one of {', '.join(table)}.")
    return table[lattice]
