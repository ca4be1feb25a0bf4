"""Numbers of the preset ``in_hand``: how often and how large the losses of a held object's frames are.

They were chosen before any estimator was tuned on the preset, from the descriptions of the paper's physical experiment
(gripper, workspace box and colour mask), not from recordings. ``losses`` applies them.
"""

from dataclasses import dataclass, field

Range = tuple[float, float]


@dataclass(frozen=True)
class Hand:
    """Ranges of a gripper's sizes, over the radius of the held object's bounding sphere."""

    three_fingers: float = 0.25
    """Share of the grippers with three fingers; the others have two."""
    finger_width: Range = (0.15, 0.35)
    """Width of a finger across the closing direction."""
    finger_thickness: Range = (0.10, 0.25)
    """Size of a finger along the closing direction."""
    reach: Range = (-0.2, 0.6)
    """Place of the fingertips along the approach axis, over the object's extent there: 0 its centre, 1 its end."""
    palm_width: Range = (0.5, 1.0)
    """Width of the palm."""
    palm_gap: Range = (0.05, 0.3)
    """Distance from the object's end to the palm."""
    palm_depth: Range = (0.3, 0.6)
    """Size of the palm along the approach axis."""
    arm_width: Range = (0.4, 0.8)
    """Width of the forearm behind the palm."""
    arm_length: float = 6.0
    """Length of the forearm."""
    towards_camera: float = 0.5
    """Largest cosine between the direction to the forearm and that to the camera, in either pose."""


@dataclass(frozen=True)
class InHand:
    """Numbers of the preset ``in_hand``, chosen before any estimator was tuned on it; lengths in pixels are for an
    image 128 pixels wide."""

    hand: Hand = field(default_factory=Hand)
    """Sizes of the gripper, which every pair has."""
    margin_px: Range = (0.0, 4.0)
    """Width by which the mask of the gripper is wider than the gripper."""
    shadow: float = 0.6
    """Share of pairs with a shadow: surface and background that a second camera or a projector does not see."""
    baseline_m: Range = (0.05, 0.2)
    """Distance of that projector from the camera, to either side."""
    shadow_px: Range = (2.0, 16.0)
    """Width of the shadow on the background beside the silhouette."""
    patches: float = 0.4
    """Share of pairs with dark patches of the surface that return nothing."""
    patch_count: tuple[int, int] = (1, 3)
    """Number of dark patches."""
    patch_radius: Range = (0.1, 0.35)
    """Their radius over that of the object's bounding sphere."""
    holes: float = 0.5
    """Share of pairs whose colour mask has holes, drawn for each image."""
    hole_share: Range = (0.02, 0.25)
    """Share of the object's pixels in holes."""
    hole_px: Range = (2.5, 8.0)
    """Scale of the holes: standard deviation of the filter of the noise whose low values they are."""
    edges: float = 0.6
    """Share of pairs whose silhouette is eroded irregularly, as at the edges of stereo matching and colour masks."""
    edge_px: Range = (1.0, 4.0)
    """Largest depth of the erosion."""
    box: float = 0.2
    """Share of pairs that a box cuts: one straight line, fixed before the camera, the same in both images."""
    frame: float = 0.25
    """Share of pairs of which one image ends beside the object: part of the object is beyond the frame."""
    cut_share: Range = (0.03, 0.3)
    """Share of the object's pixels beyond the box or the frame."""
    stray: float = 0.3
    """Share of pairs with stray returns, in both images."""
    stray_count: tuple[int, int] = (1, 5)
    """Number of stray returns of an image."""
    stray_m: Range = (0.1, 8.0)
    """Their depth, uniform in its logarithm."""
    quantum_m: Range = (0.0001, 0.001)
    """Step of the depth, uniform in its logarithm."""
    all_known: float = 0.35
    """Share of pairs all of whose losses are known."""
    none_known: float = 0.35
    """Share of pairs none of whose losses are known. In the others, each kind of loss is known or not."""
    least_kept: float = 0.35
    """Share of the object's pixels that each image keeps at least; other draws are discarded."""
