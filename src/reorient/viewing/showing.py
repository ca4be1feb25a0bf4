"""What the views of a browser share: the server, clouds, images and texts in the form that it takes."""

import queue
import threading
from contextlib import redirect_stdout
from io import StringIO
from typing import Any

import numpy as np
from jaxtyping import UInt8

from reorient.extras import import_extra
from reorient.imaging import DepthImage
from reorient.plugins import LOGGER
from reorient.reporting.pictures import shade

LOOPBACK = ("127.0.0.1", "localhost", "::1")
PORT = 8080
GOAL, CURRENT, GHOST, AXIS = (86, 180, 233), (230, 159, 0), (204, 121, 167), (240, 240, 240)

IMAGE_PX = 300


def serve(title: str, host: str, port: int) -> Any:
    """A server of views. Raises ReorientError where the extra ``view`` is not installed."""
    viser = import_extra("viser")
    with redirect_stdout(StringIO()):  # it prints its address whatever ``verbose`` is
        server = viser.ViserServer(host, port, label=title, verbose=False)
    # no share button: it would open the view to the internet
    server.gui.configure_theme(dark_mode=True, show_logo=False, show_share_button=False, control_width="large")
    server.scene.set_up_direction("-y")
    return server


class View:
    """A server of views, and a thread that draws what is put into it: whoever puts waits for nothing."""

    def __init__(self, title: str, host: str, port: int) -> None:
        """Raises ReorientError where the extra ``view`` is not installed."""
        self.server = serve(title, host, port)
        self._inbox: queue.Queue[Any] = queue.Queue()
        self._worker = threading.Thread(target=self._work, name=f"reorient view {title}", daemon=True)
        self._worker.start()

    @property
    def address(self) -> str:
        """Of the view, for a browser."""
        return f"http://{self.server.get_host()}:{self.server.get_port()}"

    def wait(self) -> None:
        """Wait until all that was put is drawn."""
        self._inbox.join()

    def close(self) -> None:
        """Draw what was put, and end the view."""
        self._inbox.put(None)
        self._worker.join()
        with redirect_stdout(StringIO()):  # in silence
            self.server.stop()

    def _draw_new(self, new: Any) -> None:
        """Draw what was put; the thread calls it."""
        raise NotImplementedError

    def _work(self) -> None:
        while (new := self._inbox.get()) is not None:
            try:
                self._draw_new(new)
            except Exception:  # whatever fails here must not end the view, nor reach what is viewed
                LOGGER.exception("the view cannot show image %d", new.index)
            finally:
                self._inbox.task_done()


def look_at(server: Any, image: DepthImage) -> tuple[np.ndarray, float]:
    """Let browsers look at the object of an image, beside the camera; its middle and its radius, metres."""
    points_m = image.points()
    middle_m = points_m.mean(axis=0)
    radius_m = float(np.linalg.norm(points_m - middle_m, axis=1).max())
    eye = middle_m + 3.2 * radius_m * np.array([0.35, -0.35, -1.0])
    server.initial_camera.position, server.initial_camera.look_at = tuple(eye), tuple(middle_m)
    return middle_m, radius_m


def point_m(image: DepthImage) -> float:
    """Distance of neighbouring pixels on the object, metres."""
    return float(image.depth_m[image.valid].mean() / image.camera.fx)


def add_cloud(scene: Any, name: str, image: DepthImage, colours: np.ndarray, visible: bool = True) -> None:
    """The returns of an image as points; a cloud of the same name is replaced."""
    points_m = image.points().astype(np.float32)
    scene.add_point_cloud(name, points_m, colours, point_size=point_m(image), precision="float32", visible=visible)


def picture(image: DepthImage) -> UInt8[np.ndarray, "h w 3"]:
    """An image shaded, its unknown pixels orange."""
    shaded = np.array(shade(image, IMAGE_PX))
    side = max(image.depth_m.shape)
    rows, columns = ((np.arange(IMAGE_PX) + 0.5) * side / IMAGE_PX for _ in range(2))
    top, left = ((side - n) // 2 for n in image.depth_m.shape)
    inside = np.pad(image.unknown, ((top, side - image.camera.height - top), (left, side - image.camera.width - left)))
    shaded[inside[np.ix_(rows.astype(int), columns.astype(int))]] = (172, 119, 0)
    return shaded


def plain(text: str) -> str:
    """Text in which Markdown and HTML have no meaning."""
    return "".join(f"\\{letter}" if letter in "\\`*_{}[]()#+!|<>~&$" else letter for letter in text)
