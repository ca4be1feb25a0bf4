"""Depth as other tools write it: each kind of file is written here byte by byte, and read back."""

import pickle
import struct

import numpy as np
import pytest
from PIL import Image

from reorient.errors import ReorientError
from reorient.imaging import DepthImage
from reorient.imaging.files import read_camera, read_depth, read_mask, write_camera


@pytest.fixture
def depth_m(camera, rng):
    """Depth with no symmetry, NaN in a corner."""
    depth_m = rng.uniform(0.5, 0.7, (camera.height, camera.width)).astype(np.float32)
    depth_m[0, 0] = np.nan
    return depth_m


def pcd(points, kind, fields="x y z rgb") -> bytes:
    height, width = points.shape[:2]
    table = np.zeros((height * width, 4), np.float32)
    table[:, :3] = points.reshape(-1, 3)
    header = (
        f"# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\nFIELDS {fields}\nSIZE 4 4 4 4\nTYPE F F F F\n"
        f"COUNT 1 1 1 1\nWIDTH {width}\nHEIGHT {height}\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {len(table)}\nDATA {kind}\n"
    ).encode()
    if kind == "ascii":
        return header + "\n".join(" ".join(map(repr, row)) for row in table.tolist()).encode() + b"\n"
    if kind == "binary":
        return header + table.tobytes()
    body = table.T.tobytes()
    packed = lzf(body)
    return header + struct.pack("<II", len(packed), len(body)) + packed


def lzf(data: bytes) -> bytes:
    """Literal runs, and a reference wherever the last four bytes repeat (an unbroken run of zeros does)."""
    out, i = bytearray(), 0
    while i < len(data):
        run = 0
        while run < 200 and i >= 4 and i + run < len(data) and data[i + run] == data[i + run - 4]:
            run += 1
        if run >= 9:
            out += bytes([(7 << 5) | 0, run - 2 - 7, 3])  # 4 bytes back
            i += run
            continue
        chunk = data[i : i + 8]
        out += bytes([len(chunk) - 1]) + chunk
        i += len(chunk)
    return bytes(out)


def ply(points, form, organised=True) -> bytes:
    height, width = points.shape[:2]
    info = f"obj_info num_cols {width}\nobj_info num_rows {height}\n" if organised else ""
    header = (
        f"ply\nformat {form} 1.0\ncomment made by hand\n{info}element vertex {height * width}\nproperty double x\n"
        "property double y\nproperty double z\nproperty uchar red\nelement face 0\n"
        "property list uchar int vertex_indices\nend_header\n"
    ).encode()
    flat = points.reshape(-1, 3)
    if form == "ascii":
        return header + "".join(f"{x!r} {y!r} {z!r} 7\n" for x, y, z in flat.tolist()).encode()
    order = "<" if form == "binary_little_endian" else ">"
    table = np.zeros(len(flat), np.dtype([("p", f"{order}f8", 3), ("red", "u1")]))
    table["p"] = flat
    return header + table.tobytes()


@pytest.mark.parametrize("kind", ["ascii", "binary", "binary_compressed"])
def test_organised_pcd(kind, tmp_path, camera, depth_m):
    (tmp_path / "cloud.pcd").write_bytes(pcd(camera.rays() * depth_m[..., None], kind))
    assert_same(read_depth(tmp_path / "cloud.pcd", camera), depth_m, camera)


@pytest.mark.parametrize("form", ["ascii", "binary_little_endian", "binary_big_endian"])
@pytest.mark.parametrize("organised", [True, False])
def test_ply(form, organised, tmp_path, camera, depth_m):
    """In no order, too: the camera has the size, and every point projects to its pixel."""
    (tmp_path / "cloud.PLY").write_bytes(ply(camera.rays() * depth_m[..., None], form, organised))
    assert_same(read_depth(tmp_path / "cloud.PLY", camera), depth_m, camera)


def assert_same(image: DepthImage, depth_m, camera):
    assert image.camera == camera
    assert np.array_equal(image.unknown, np.isnan(depth_m))
    assert np.allclose(image.depth_m, np.nan_to_num(depth_m), atol=1e-6)


def test_points_and_single_channels_as_arrays(tmp_path, camera, depth_m):
    for name, array in (
        ("xyz", camera.rays() * depth_m[..., None]),
        ("h_w_1", depth_m[..., None]),
        ("1_h_w", depth_m[None]),
    ):
        np.save(tmp_path / f"{name}.npy", array)
        assert_same(read_depth(tmp_path / f"{name}.npy", camera), depth_m, camera)


def test_the_only_image_of_an_archive(tmp_path, camera, depth_m):
    np.savez(tmp_path / "a.npz", depth_m[..., None])  # arr_0
    assert_same(read_depth(tmp_path / "a.npz", camera), depth_m, camera)
    np.savez(tmp_path / "b.npz", depth=depth_m, time=np.array(3.0), K=np.arange(9.0))
    assert_same(read_depth(tmp_path / "b.npz", camera), depth_m, camera)
    np.savez(tmp_path / "c.npz", depth=depth_m, color=depth_m)
    with pytest.raises(ReorientError, match="holds depth, color: expected an array depth_m, or one image alone"):
        read_depth(tmp_path / "c.npz", camera)


@pytest.mark.parametrize("suffix", [".png", ".pgm", ".npy", ".npz", ".tif", ".PNG", ".PGM", ".NPY", ".TIFF"])
def test_16_bits_are_millimetres_and_65535_no_return(suffix, tmp_path, camera, depth_m):
    units = np.where(np.isnan(depth_m), 65535, np.rint(np.nan_to_num(depth_m) * 1000)).astype(np.uint16)
    path = tmp_path / f"depth{suffix}"
    if suffix.lower() == ".pgm":
        path.write_bytes(b"P5\n# a comment\n96 72\n65535\n" + units.astype(">u2").tobytes())
    elif suffix.lower() in (".npy", ".npz"):
        with path.open("wb") as file:
            (np.save if suffix.lower() == ".npy" else np.savez)(file, units)
    else:
        Image.fromarray(units).save(path)
    image = read_depth(path, camera)
    assert np.array_equal(image.unknown, np.isnan(depth_m))
    assert np.abs(image.depth_m - np.nan_to_num(depth_m)).max() <= 0.00051
    assert np.allclose(read_depth(path, camera, 0.002).depth_m, 2 * image.depth_m)


def test_a_pgm_of_less_than_16_bits_keeps_its_units(tmp_path, camera):
    """Its largest value is no scale: 10000 millimetres are not stretched to 65535."""
    values = np.full((72, 96), 600)
    (tmp_path / "a.pgm").write_bytes(b"P2 96 72 10000\n" + " ".join(map(str, values.ravel())).encode())
    (tmp_path / "b.pgm").write_bytes(b"P5 96 72 10000\n" + values.astype(">u2").tobytes())
    for name in ("a.pgm", "b.pgm"):
        assert np.allclose(read_depth(tmp_path / name, camera).depth_m, 0.6)
    (tmp_path / "c.pgm").write_bytes(b"P5 96 72 255\n" + bytes(96 * 72))
    with pytest.raises(ReorientError, match="is no PGM of 16 bits"):
        read_depth(tmp_path / "c.pgm", camera)


@pytest.mark.parametrize(("scale", "kind"), [("-1.0", "<f4"), ("1.0", ">f4")])
def test_pfm_begins_at_the_bottom(scale, kind, tmp_path, camera, depth_m):
    (tmp_path / "d.pfm").write_bytes(f"Pf\n96 72\n{scale}\n".encode() + depth_m[::-1].astype(kind).tobytes())
    assert_same(read_depth(tmp_path / "d.pfm", camera), depth_m, camera)
    (tmp_path / "d.pfm").write_bytes(b"PF\n96 72\n-1\n" + bytes(96 * 72 * 12))
    with pytest.raises(ReorientError, match="is no PFM with one channel"):
        read_depth(tmp_path / "d.pfm", camera)


@pytest.mark.parametrize("channels", [("Z",), ("Y",), ("R", "G", "B"), ("R", "G", "B", "Z")])
def test_exr(channels, tmp_path, camera, depth_m):
    openexr = pytest.importorskip("OpenEXR")
    values = {name: depth_m if name in (channels[0], "Z") or "Z" not in channels else depth_m + 1 for name in channels}
    openexr.File({"type": openexr.scanlineimage}, values).write(str(tmp_path / "d.exr"))
    assert_same(read_depth(tmp_path / "d.exr", camera), depth_m, camera)


def test_exr_of_a_colour_picture_is_refused(tmp_path, camera, depth_m):
    openexr = pytest.importorskip("OpenEXR")
    values = {name: depth_m + i for i, name in enumerate("RGB")}
    openexr.File({"type": openexr.scanlineimage}, values).write(str(tmp_path / "d.exr"))
    with pytest.raises(ReorientError, match="holds the channels .*expected Z, or one channel alone"):
        read_depth(tmp_path / "d.exr", camera)


def test_exr_without_its_package_names_the_extra(tmp_path, camera, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "OpenEXR", None)
    (tmp_path / "d.exr").write_bytes(b"v/1\x01")
    with pytest.raises(ReorientError, match=r"needs OpenEXR: pip install 'reorient\[exr\]'"):
        read_depth(tmp_path / "d.exr", camera)


@pytest.mark.parametrize("name", ["depth.pkl", "depth.pickle", "depth.npy", "depth.npz", "depth.png"])
def test_a_pickle_is_named_and_never_loaded(name, tmp_path, camera):
    (tmp_path / name).write_bytes(pickle.dumps(np.ones((72, 96))))
    for read in (read_depth, lambda path, _: read_camera(path), lambda path, _: read_mask(path)):
        with pytest.raises(ReorientError, match="is a pickle, which can run code when it is loaded"):
            read(tmp_path / name, camera)


@pytest.mark.parametrize("suffix", [".pcd", ".ply", ".pgm", ".pfm"])
@pytest.mark.parametrize("share", [0.0, 0.01, 0.1, 0.5, 0.9])
def test_truncated_files_are_refused(suffix, share, tmp_path, camera, depth_m):
    points = camera.rays() * depth_m[..., None]
    whole = {
        ".pcd": pcd(points, "binary_compressed"),
        ".ply": ply(points, "ascii"),
        ".pgm": b"P5 96 72 65535\n" + bytes(2 * 96 * 72),
        ".pfm": b"Pf 96 72 -1\n" + bytes(4 * 96 * 72),
    }[suffix]
    path = tmp_path / f"depth{suffix}"
    path.write_bytes(whole[: int(share * len(whole))])
    with pytest.raises(ReorientError, match="expected") as caught:
        read_depth(path, camera)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("name", "data", "message"),
    [
        ("a.pcd", pcd(np.ones((2, 3, 3)), "ascii", fields="a b c rgb"), "has the fields a b c rgb, no x y z"),
        ("a.ply", ply(np.ones((2, 3, 3)), "ascii").replace(b"double z", b"double q"), "no z: expected points x y z"),
        ("a.ply", ply(np.ones((2, 3, 3)), "ascii").replace(b"element vertex", b"element node"), "no vertices first"),
    ],
)
def test_clouds_without_points_are_refused(name, data, message, tmp_path, camera):
    (tmp_path / name).write_bytes(data)
    with pytest.raises(ReorientError, match=message):
        read_depth(tmp_path / name, camera)


def test_8_bits_are_no_depth(tmp_path, camera):
    np.save(tmp_path / "d.npy", np.full((72, 96), 100, np.uint8))
    with pytest.raises(ReorientError, match="depth of dtype uint8: expected 16 bits or more"):
        read_depth(tmp_path / "d.npy", camera)


def test_a_cloud_in_no_order_needs_a_camera_with_a_size(tmp_path, camera, depth_m):
    (tmp_path / "c.ply").write_bytes(ply(camera.rays() * depth_m[..., None], "ascii", organised=False))
    (tmp_path / "K.txt").write_text("110 0 44.75\n0 104 33\n0 0 1")
    with pytest.raises(ReorientError, match="holds 6912 points in no order, .*expected width and height"):
        read_depth(tmp_path / "c.ply", tmp_path / "K.txt")
    write_camera(tmp_path / "c.json", camera)
    assert_same(read_depth(tmp_path / "c.ply", tmp_path / "c.json"), depth_m, camera)
