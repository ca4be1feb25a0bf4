"""The fields of one camera, under the names that other tools give them: focal lengths, size, distortion, depth scale.

Names are compared without case, underscores and other signs. docs/formats.md lists the tools, and where each counts
pixel centres.
"""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from reorient.errors import ReorientError
from reorient.imaging.camera import LARGEST_PX, Camera
from reorient.imaging.distortion import Distortion, Model

Fields = Mapping[str, Any]
"""The values of one camera by bare name, those of the levels above it included."""

MATRIX = ("k", "camk", "cameramatrix", "intrinsicmatrix", "intrinsicsmatrix", "mtx", "intrinsics", "intrinsic")
FX, FY = ("fx", "flx"), ("fy", "fly")
CX, CY = ("cx", "ppx"), ("cy", "ppy")
WIDTH, HEIGHT = ("width", "w", "imagewidth", "resolutionx"), ("height", "h", "imageheight", "resolutiony")
SIZE = ("imagesize", "resolution")
COEFFICIENTS = (
    *("d", "coeffs", "distortioncoefficients", "distortioncoeffs", "distcoeffs", "dist", "distortion"),
    *("distortionparameters", "distortionparams"),
)
SCALARS = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6", "s1", "s2", "s3", "s4")
MODEL = ("distortionmodel", "distortiontype", "distortion", "distorsion", "model", "cameramodel", "modeltype")
_MODELS: dict[str, Model | None] = {
    **dict.fromkeys(("none", ""), None),
    **dict.fromkeys(
        ("plumbbob", "brownconrady", "brown", "opencv", "fullopencv", "radtan", "radialtangential"), "brown"
    ),
    **dict.fromkeys(("rationalpolynomial", "pinhole", "perspective"), "brown"),
    **dict.fromkeys(("modifiedbrownconrady", "inversebrownconrady"), "modified"),
    **dict.fromkeys(("equidistant", "fisheye", "opencvfisheye", "kannalabrandt4", "kannalabrandt"), "fisheye"),
}
_REALSENSE = ("none", "modifiedbrownconrady", "inversebrownconrady", "ftheta", "brownconrady", "kannalabrandt4")
_LENS = re.compile(r"distor(?!tionmodel)|^dist(coeff|$)|coeff|^k[1-9]$|^[ps][1-4]$|^cod[xy]$|^xi$|skew")
_SCALES: dict[str, Callable[[float], float]] = {
    **dict.fromkeys(("depthscalem", "depthunits"), lambda x: x),
    "depthscalemm": lambda x: x / 1000,
    **dict.fromkeys(("factordepth", "depthfactor"), lambda x: 1 / x),
}
_SAME = 1e-3  # relative difference of two statements of one scale
_RANGES = ((1e-6, 0.005, 1.0, 1.0), (0.01, 10.0, 0.001, 1.0), (100.0, 1e5, 1.0, -1.0))  # from, to, factor, power


def bare(name: object) -> str:
    """A name without case and signs: ``cam_K`` gives ``camk``."""
    return re.sub(r"[^a-z0-9]", "", str(name).lower())


@dataclass(frozen=True)
class Intrinsics:
    """What a camera file states: a pinhole camera, perhaps without size, a lens distortion, a depth scale."""

    fx: float
    fy: float
    cx: float
    """Principal point, pixel centres at +0.5."""
    cy: float
    width: int | None = None
    height: int | None = None
    distortion: Distortion = field(default_factory=Distortion)
    scale_m: float | None = None
    """Metres per unit of integer depth."""

    def camera(self, width: int | None = None, height: int | None = None) -> Camera:
        """The camera, with this size where it states none. Raises ReorientError as Camera."""
        width, height = self.width or width, self.height or height
        if width is None or height is None:
            raise ReorientError("no image size: expected width and height beside the intrinsics")
        return Camera(width, height, self.fx, self.fy, self.cx, self.cy)


def has_focal_length(fields: Fields) -> bool:
    """Whether these are the fields of a camera."""
    return any(_matrix(fields, name) is not None for name in MATRIX) or (
        _first(fields, FX) is not None and _first(fields, FY) is not None
    )


def intrinsics_of(fields: Fields) -> Intrinsics:
    """The intrinsics of one camera. Raises ReorientError for missing values and for a distortion of unknown meaning."""
    width, height = _size(fields)
    optics = _optics(fields)
    intrinsics = Intrinsics(*optics, width, height, _distortion(fields), depth_scale_m(fields))
    return _windowed(intrinsics, fields)


def distortion_of(model: object, coefficients: Any) -> Distortion:
    """A lens distortion by the name of its model. Raises ReorientError for an unknown one that is not zero."""
    values = tuple(map(_number, np.ravel(np.asarray(coefficients, object)).tolist()))
    name = _REALSENSE[model] if isinstance(model, int) and 0 <= model < len(_REALSENSE) else bare(model)
    name = name.removeprefix("distortion").removeprefix("calibrationlensdistortionmodel")
    kind = _MODELS.get(name)
    if kind is not None:
        return Distortion(kind, values)
    if any(values):
        raise ReorientError(
            f"lens distortion {list(values)} of model {str(model)!r}: expected one of plumb_bob, rational_polynomial, "
            "Brown-Conrady, inverse or modified Brown-Conrady, equidistant; or undistorted images and no coefficients"
        )
    return Distortion()


def depth_scale_m(fields: Fields) -> float | None:
    """Metres per unit of integer depth, None where it is not stated.

    ``depth_scale`` has three meanings, which differ by powers of ten: metres per unit (RealSense, 0.001), millimetres
    per unit (BOP, 0.1 to 1), units per metre (Open3D, TUM, 1000 to 10000). Raises ReorientError for others or two.
    """
    stated = {
        name: metres(_positive(name, value))
        for name, metres in _SCALES.items()
        if (value := _first(fields, (name,))) is not None
    }
    if (value := _first(fields, ("depthscale",))) is not None:
        stated["depth_scale"] = _scale_m(_positive("depth_scale", value))
    if stated and max(stated.values()) > (1 + _SAME) * min(stated.values()):
        words = " and ".join(f"{name} ({scale_m:g} m)" for name, scale_m in stated.items())
        raise ReorientError(f"{words} contradict each other: expected one depth scale; remove the wrong one")
    return next(iter(stated.values()), None)


def _scale_m(scale: float) -> float:
    """Metres per unit by the size of ``depth_scale``."""
    for low, high, factor, power in _RANGES:
        if low <= scale <= high:
            return float(factor * scale**power)
    raise ReorientError(
        f"depth_scale {scale:g}: expected metres per unit (0.001), millimetres per unit (1) or units per metre (1000); "
        "remove it and give the scale as metres per unit (--depth-scale)"
    )


def _positive(name: str, value: Any) -> float:
    number = _number(value)
    if not 0 < number < np.inf:
        raise ReorientError(f"{name} {number:g}: expected a number above 0")
    return number


def _optics(fields: Fields) -> tuple[float, float, float, float]:
    """(fx, fy, cx, cy) with pixel centres at +0.5."""
    K = next((K for name in MATRIX if (K := _matrix(fields, name)) is not None), None)
    if K is not None:
        camera = Camera.from_K(K, 1, 1)
        return camera.fx, camera.fy, camera.cx, camera.cy
    found = {name: _first(fields, names) for name, names in (("fx", FX), ("fy", FY), ("cx", CX), ("cy", CY))}
    if missing := [name for name, value in found.items() if value is None]:
        raise ReorientError(f"missing intrinsics, no {' and '.join(missing)}: expected fx, fy, cx, cy in pixels")
    fx, fy, cx, cy = map(_number, found.values())
    offset = 0.5 - _pixel_centers(fields)
    return fx, fy, cx + offset, cy + offset


def _pixel_centers(fields: Fields) -> float:
    """Where the first pixel's centre is counted: 0.5 in files of reorient and nerfstudio, 0 elsewhere.

    A file of width, height, fx, fy, cx, cy alone counts as one of reorient.
    """
    stated = _first(fields, ("pixelcentersat",))
    if stated is not None:
        return _number(stated)
    own = {"width", "height", "fx", "fy", "cx", "cy"}
    return 0.5 if "flx" in fields or set(fields) <= own else 0.0


def _matrix(fields: Fields, name: str) -> np.ndarray | None:
    """A field as 3 x 3 matrix: nested, of nine numbers by rows or (Open3D) by columns, with rows, cols and data, of
    four numbers fx fy cx cy (Kalibr); None for anything else."""
    value = fields.get(name)
    if isinstance(value, Mapping):
        value = {bare(key): x for key, x in value.items()}.get("data")
    if not isinstance(value, list | tuple):
        return None
    try:
        numbers = np.array([_number(x) for x in np.ravel(np.array(value, object)).tolist()])
    except (ReorientError, ValueError):
        return None
    if len(numbers) == 4 and name in ("intrinsics", "intrinsic"):
        fx, fy, cx, cy = numbers
        return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    if len(numbers) != 9:
        return None
    K = numbers.reshape(3, 3)
    return K.T if np.any(K[2, :2]) and not np.any(K[:2, 2]) else K


def _size(fields: Fields) -> tuple[int | None, int | None]:
    both = next((fields[name] for name in SIZE if isinstance(fields.get(name), list | tuple)), None)
    width, height = both if both is not None and len(both) == 2 else (_first(fields, WIDTH), _first(fields, HEIGHT))
    sizes = [None if value is None else _number(value) for value in (width, height)]
    for size in sizes:
        if size is not None and not (np.isfinite(size) and size == int(size) and size >= 1):
            raise ReorientError(f"an image of {width} x {height} px: expected whole numbers above 0")
    width, height = (None if size is None else int(size) for size in sizes)
    return width, height


def _distortion(fields: Fields) -> Distortion:
    """The lens distortion. Raises ReorientError for one that is stated but not understood: none is ever ignored."""
    fields = _flattened(fields)
    array = next((name for name in COEFFICIENTS if isinstance(fields.get(name), list | tuple)), None)
    model = next((fields[name] for name in MODEL if isinstance(fields.get(name), str | int)), "opencv")
    if _number(fields.get("fisheyemodel", 0)) == 1:
        model = "fisheye"
    if array is not None:
        values, used = fields[array], {array}
    else:
        names = ("k1", "k2", "k3", "k4") if "fisheye" in bare(model) else SCALARS
        values, used = [fields.get(name, 0) for name in names], set(names)
        if names == SCALARS and "k5" not in fields and _number(fields.get("k4", 0)):
            used.remove("k4")  # nerfstudio's fourth radial term, not the rational model's
    for name in fields:
        if _LENS.search(name) and name not in used and _nonzero(fields[name]):
            raise ReorientError(
                f"lens distortion or skew {name!r} is not understood: expected OpenCV's k1, k2, p1, p2, k3, ..., or "
                "undistorted images and a camera file without it"
            )
    return distortion_of(model, values)


def _flattened(fields: Fields) -> Fields:
    """The fields with those of a nested distortion (an OpenCV matrix, a dict of k1, k2, ...) beside the others."""
    name = next((name for name in COEFFICIENTS if isinstance(fields.get(name), Mapping)), None)
    if name is None:
        return fields
    inner = {bare(key): value for key, value in fields[name].items()}
    others = {key: value for key, value in fields.items() if key != name}
    if isinstance(inner.get("data"), list | tuple | float | int):
        return {**others, name: np.ravel(np.asarray(inner["data"], object)).tolist()}
    known = {*SCALARS, *COEFFICIENTS, *MODEL}
    return {**others, **{key if key in known else f"distortion{key}": value for key, value in inner.items()}}


def _nonzero(value: Any) -> bool:
    """Whether there is a number other than 0 anywhere in it."""
    if isinstance(value, Mapping):
        return any(map(_nonzero, value.values()))
    if isinstance(value, list | tuple):
        return any(map(_nonzero, value))
    return isinstance(value, int | float) and value != 0


def _windowed(intrinsics: Intrinsics, fields: Fields) -> Intrinsics:
    """ROS: a window (``roi``) and binning of the sensor that width, height, K refer to."""
    roi = fields.get("roi")
    window = {bare(key): _whole(x) for key, x in roi.items()} if isinstance(roi, Mapping) else {}
    if window.get("width") and window.get("height"):
        left, top = window.get("xoffset", 0), window.get("yoffset", 0)
        intrinsics = replace(
            intrinsics,
            width=window["width"],
            height=window["height"],
            cx=intrinsics.cx - left,
            cy=intrinsics.cy - top,
        )
    x, y = (max(1, _whole(fields.get(name, 1))) for name in ("binningx", "binningy"))
    if (x, y) == (1, 1) or intrinsics.width is None or intrinsics.height is None:
        return intrinsics
    return replace(
        intrinsics,
        width=intrinsics.width // x,
        height=intrinsics.height // y,
        fx=intrinsics.fx / x,
        fy=intrinsics.fy / y,
        cx=intrinsics.cx / x,
        cy=intrinsics.cy / y,
    )


def _first(fields: Fields, names: tuple[str, ...]) -> Any:
    """The first of these fields that holds one value."""
    return next((fields[name] for name in names if isinstance(fields.get(name), int | float | str)), None)


def _whole(value: Any) -> int:
    """A whole number from 0. Raises ReorientError for anything else."""
    number = _number(value)
    if not 0 <= number <= LARGEST_PX:
        raise ReorientError(f"{number:g} px: expected a whole number from 0 to {LARGEST_PX}")
    return int(number)


def _number(value: Any) -> float:
    """A number, also where it was written as text (YAML reads 1e-3 as text). Raises ReorientError for anything else."""
    try:
        return float(value)
    except (TypeError, ValueError, OverflowError) as error:
        try:
            words = repr(value)[:40]
        except ValueError:
            words = "a number of thousands of digits"
        raise ReorientError(f"{words} is no number: expected numbers in the intrinsics") from error
