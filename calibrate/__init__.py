"""Fits a discrete element test to data, with exact derivatives and a statement of their health.

Public names are loaded when they are first used, so that `import calibrate` costs next to nothing. Compression is
positive for stress and strain, strains are fractions.
"""

from importlib import import_module

_PLACES = {
    "targets": ("Datum", "HardPeak", "InitialSlope", "RatioAt", "SmoothPeak", "StrainAtPeak", "WindowMean"),
    "branches": ("OnBranch",),
    "functionals": (
        "E50",
        "FrictionAngle",
        "MaxDilatancy",
        "StressDilatancy",
        "VoidRatioAt",
        "VolumeAt",
        "rowe_constant",
    ),
    "measured": ("DataError", "MeasuredCurve", "ROWE", "RoweTest", "read_measured"),
    "parameters": ("ParameterSet", "Prior"),
    "model": ("Cost", "Model", "RunFailed", "jacobian_of", "stretch_tangent"),
    "gradients": ("Gradient", "Health", "gradient", "gradient_health"),
    "reverse": ("FrictionMap", "friction_map"),
    "evaluate": ("Evaluation", "Evaluator"),
    "fit": ("fit_parameters",),
    "result": ("Fit",),
    "secant": ("fit_friction_to_peak", "fit_one"),
    "descent": ("fit_by_descent", "fit_friction_per_ball"),
    "scene": ("RandomScene",),
    "library": ("Library", "library_folder"),
    "study": ("LABORATORY", "StudyTest", "fit_study"),
    "study_result": ("StudyFit",),
    "file": ("calibrate_file",),
    "sensitivity": ("Sensitivity", "further_tests", "sensitivity"),
}
_HOME = {name: module for module, names in _PLACES.items() for name in names}

__all__ = sorted(_HOME)


def __getattr__(name: str):
    if name not in _HOME:
        raise AttributeError(f"module 'calibrate' has no attribute '{name}'; it has {', '.join(__all__)}.")
    value = getattr(import_module(f"calibrate.{_HOME[name]}"), name)
    globals()[name] = value
    return value


def __dir__():
    return __all__
