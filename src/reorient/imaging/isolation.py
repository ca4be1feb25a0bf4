"""Isolating an object: which returns of a raw frame show it, and which pixels are unknown."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import isfinite
from operator import index
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Shaped

from reorient.errors import ReorientError
from reorient.imaging.connected import object_clusters
from reorient.imaging.depth_image import DepthImage
from reorient.imaging.masks import Mask
from reorient.imaging.planes import Plane, above, continuing_planes, off_surface
from reorient.imaging.refusals import refuse_continuing, refuse_second_object, require_isolated
from reorient.imaging.unknown import unknown_beside

_EVERYTHING = 0.95  # share of the frame above which a mask selects nothing
_CHANGED_M = 0.02  # differences to the empty frame up to this are noise or low objects, from which the noise is found


@dataclass(frozen=True)
class Isolation:
    """Isolates one object in raw depth frames; call it with a frame.

    Of the returns inside the box, the depth range, the sphere and a mask, those of planes and of the empty scene are
    removed on request. The largest cluster of the rest is the object, with the clusters that belong to it. Raises
    ReorientError for invalid fields.
    """

    box_px: tuple[int, int, int, int] | None = None
    """Left, top, width and height of a box that holds the object, px. It may reach beyond the frame."""
    near_m: float | None = None
    """Smallest depth of the object, metres."""
    far_m: float | None = None
    """Largest depth of the object, metres."""
    around_m: tuple[float, float, float] | None = None
    """Centre of a sphere that holds the object, camera axes, metres."""
    radius_m: float | None = None
    """Radius of this sphere, metres."""
    remove_plane: bool = False
    """Remove planes that continue beyond the box, depth range, sphere and mask, or beyond the frame: a table, walls.
    Objects of at least 5 mm height on them are kept."""
    background: DepthImage | str | Path | None = None
    """Frame of the same camera without the object, or its file: returns that are there as well are removed."""
    allow_touching: bool = False
    """Accept an object that continues beyond the box, depth range or sphere, that lies in a plane which continues, or
    of two separate parts of similar size."""

    def __post_init__(self) -> None:
        if self.box_px is not None:
            object.__setattr__(self, "box_px", _checked_box(self.box_px))
        for name in ("near_m", "far_m", "radius_m"):
            value = getattr(self, name)
            if value is not None and not (_is_number(value) and value >= 0):
                raise ReorientError(f"{name}={value!r}: expected metres from 0")
        if not (self.near_m or 0.0) < (np.inf if self.far_m is None else self.far_m):
            raise ReorientError(f"depth range {self.near_m or 0:g} to {self.far_m:g} m: expected near below far")
        if (self.around_m is None) != (self.radius_m is None):
            raise ReorientError("a sphere needs its centre and its radius: expected around_m and radius_m, or neither")
        if self.around_m is not None:
            object.__setattr__(self, "around_m", _checked_point(self.around_m))
        self._check_types()

    def _check_types(self) -> None:
        """Raise ReorientError for fields of another type, as of a file: "no" would count as true."""
        for name in ("remove_plane", "allow_touching"):
            if not isinstance(getattr(self, name), bool | np.bool_):
                raise ReorientError(f"{name}={getattr(self, name)!r}: expected true or false")
        if not isinstance(self.background, DepthImage | str | Path | None):
            raise ReorientError(f"background={self.background!r}: expected a DepthImage or the name of its file")

    def __call__(self, image: DepthImage, mask: Shaped[np.ndarray, "height width"] | None = None) -> DepthImage:
        """The image of the object alone.

        ``mask``: not zero on the object. Removed returns in front of the object, and pixels without return inside it or
        next to it, become unknown; all others are not the object. Without mask and fields all returns are kept. Raises
        ReorientError where nothing is left, for a mask of another size, and where the remaining returns are no isolated
        object: it continues beyond what was chosen, a plane that continues holds most of it, or it is two.
        """
        if mask is None and self == Isolation():
            raw = bool(np.all(image.valid | image.unknown))  # background out of range is not distinguished
            unknown = unknown_beside(image, image.valid, image.valid) if raw else image.unknown
            return require_isolated(replace(image, unknown=unknown))
        inside = np.ones(image.valid.shape, bool) if mask is None else _checked_mask(mask, image)
        part = self._part(image, inside)
        planes = continuing_planes(image, part & inside)
        kept, doubtful = self._without_surfaces(image, part & inside, planes)
        found = object_clusters(image, kept, trusted=mask is not None)
        if self.allow_touching:
            object_mask = found.mask if found.other is None else found.mask | found.other
        else:
            object_mask = found.mask
            refuse_second_object(image, found)
            refuse_continuing(image, object_mask, part, planes, trusted=mask is not None)
        unknown = unknown_beside(image, object_mask, kept, doubtful, None if mask is None else inside)
        isolated = replace(image, depth_m=np.where(object_mask, image.depth_m, np.float32(0)), unknown=unknown)
        return require_isolated(isolated)

    def _without_surfaces(self, image: DepthImage, part: Mask, planes: Sequence[Plane]) -> tuple[Mask, Mask]:
        """The returns of a part of the frame without planes and the empty scene, and the doubtful ones of the removed.

        Raises ReorientError where none are left.
        """
        kept, doubtful = np.asarray(part & image.valid), np.zeros_like(part)
        for plane in planes if self.remove_plane else ():
            if plane.is_wide:
                off, perhaps = above(image, part, plane)
                kept, doubtful = kept & off, doubtful | perhaps
        _require(kept, "no returns are left beside the removed planes: expected an object at least 5 mm high")
        if self.background is not None:
            off, perhaps = _changed(image, self._empty_frame(image), part)
            kept, doubtful = kept & off, doubtful | perhaps
            _require(kept, "no returns differ from the background: expected an object that the empty frame lacks")
        return kept, doubtful & ~kept

    def _part(self, image: DepthImage, inside: Mask) -> Mask:
        """The pixels inside the box, the depth range and the sphere; those without return satisfy the latter two.

        Raises ReorientError, with the depths found, if none of them inside the mask has a return.
        """
        part = np.ones_like(inside) if self.box_px is None else _inside_box(self.box_px, inside.shape)
        seen = image.valid & inside & part
        where = " and ".join(["the mask"] * (not inside.all()) + ["the box"] * (self.box_px is not None))
        _require(seen, f"no returns inside {where}: expected the object there (box: left, top, width, height in px)")
        depths_m = image.depth_m[seen]
        near_m, far_m = self.near_m or 0.0, np.inf if self.far_m is None else self.far_m
        part &= (image.depth_m == 0) | ((image.depth_m >= near_m) & (image.depth_m <= far_m))
        limits = [f"--{name} is {x:g}" for name, x in (("near", self.near_m), ("far", self.far_m)) if x is not None]
        found = f"depths are {depths_m.min():.2f}-{depths_m.max():.2f} m"
        _require(seen & part, f"no returns in the depth range: {found}; {', '.join(limits)}")
        if self.around_m is not None and self.radius_m is not None:
            points_m = image.camera.rays() * image.depth_m[..., None]
            distances_m = np.linalg.norm(points_m - np.asarray(self.around_m), axis=-1)
            nearest_m = float(distances_m[seen & part].min())
            part &= (image.depth_m == 0) | (distances_m <= self.radius_m)
            _require(
                seen & part,
                f"no returns within {self.radius_m:g} m of {self.around_m}: the nearest is {nearest_m:.2f} m away, "
                f"{found} (expected x, y, z in camera axes, metres)",
            )
        return part

    def _empty_frame(self, image: DepthImage) -> DepthImage:
        """The background as an image. Raises ReorientError for a frame of another size, and for broken files."""
        empty = self.background
        if not isinstance(empty, DepthImage):
            from reorient.imaging.files import read_depth

            empty = read_depth(str(empty), image.camera)
        if empty.depth_m.shape != image.depth_m.shape:
            raise ReorientError(
                f"background of shape {empty.depth_m.shape}: expected {image.depth_m.shape} as the frame, from the "
                "same camera at the same place"
            )
        return empty


def isolate(image: DepthImage, mask: Shaped[np.ndarray, "height width"] | None = None, **fields: Any) -> DepthImage:
    """``Isolation(**fields)(image, mask)``: the image of one object, isolated once."""
    return Isolation(**fields)(image, mask)


def _changed(image: DepthImage, empty: DepthImage, part: Mask) -> tuple[Mask, Mask]:
    """The returns nearer than those of the empty frame by more than its noise, or where that frame has none; and the
    doubtful ones."""
    nearer_m = empty.depth_m - image.depth_m
    both = image.valid & empty.valid
    unchanged_m = np.abs(nearer_m[both & part & (np.abs(nearer_m) < _CHANGED_M)])
    noise_m = float(np.median(unchanged_m)) / 0.6745 if unchanged_m.size else 0.0
    off, doubtful = off_surface(nearer_m, both, part, noise_m)
    return (off & (nearer_m > 0)) | (image.valid & ~empty.valid), doubtful & (nearer_m > 0)


def _require(kept: Mask, message: str) -> None:
    if not kept.any():
        raise ReorientError(message)


def _is_number(value: object) -> bool:
    return isinstance(value, int | float | np.number) and not isinstance(value, bool) and isfinite(value)


def _checked_point(point_m: Any) -> tuple[float, float, float]:
    try:
        x, y, z = (float(each) for each in point_m)
    except (TypeError, ValueError) as error:
        raise ReorientError(f"around_m={point_m!r}: expected x, y, z in camera axes, metres") from error
    if not np.isfinite([x, y, z]).all():
        raise ReorientError(f"around_m={point_m!r}: expected x, y, z in camera axes, metres")
    return x, y, z


def _checked_mask(mask: Shaped[np.ndarray, "..."], image: DepthImage) -> Mask:
    inside = np.asarray(np.asarray(mask) != 0)
    if inside.shape != image.depth_m.shape:
        raise ReorientError(f"mask of shape {inside.shape}: expected {image.depth_m.shape} as its depth image")
    if not inside.any():
        raise ReorientError("the mask is empty: expected non-zero pixels on the object")
    if inside.mean() > _EVERYTHING:
        raise ReorientError(
            f"the mask covers {inside.mean():.0%} of the frame: expected non-zero pixels on the object alone, and 0 "
            "elsewhere"
        )
    return inside


def _checked_box(box_px: Any) -> tuple[int, int, int, int]:
    try:
        left, top, width, height = (index(x) for x in box_px)
    except (TypeError, ValueError) as error:
        raise ReorientError(f"box {box_px}: expected left, top, width, height in whole pixels") from error
    if width < 1 or height < 1:
        raise ReorientError(f"box of {width} x {height} px: expected left, top, width, height with a size above 0")
    return left, top, width, height


def _inside_box(box_px: tuple[int, int, int, int], shape: tuple[int, ...]) -> Mask:
    left, top, width, height = box_px
    inside = np.zeros(shape, bool)
    inside[max(top, 0) : max(top + height, 0), max(left, 0) : max(left + width, 0)] = True
    return inside
