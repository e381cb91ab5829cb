"""`dissect look`: the left picture, rectified, as a session would see it, for drawing a goal on. It only listens."""

from __future__ import annotations

import time
from pathlib import Path

import cv2

from hardware.codes import InputError
from hardware.dvrk.choose_transport import make_transport
from hardware.dvrk.config import load_robot
from hardware.dvrk.endoscope import EndoscopeDVRK
from hardware.dvrk.transport import TransportError
from hardware.interface import Image
from hardware.stub.bench import StubBench
from hardware.stub.scene import Scene

NODE = "dissection_supervisor_look"
ASK_AGAIN = 0.05  # [s]


def look_at_stub(scene: Scene, seed: int) -> Image:
    """The picture (H, W, 3) that the first frame of a session with this scene and seed is."""
    return StubBench(scene, seed).endoscope.left().image


def look_at_robot(file: Path) -> Image:
    """The newest picture (H, W, 3) of the robot whose configuration `file` is. Its arms are not even listened to.

    Raises:
        InputError: the configuration is wrong, there is no ROS, its master does not answer, or no good pair of pictures came.
    """
    config = load_robot(file)
    try:
        transport = make_transport(config.transport, NODE)
    except TransportError as error:
        raise InputError(str(error)) from error
    try:
        endoscope = EndoscopeDVRK(transport, config.camera, config.prefix, transport.clock())
        until = transport.clock() + config.rates.connect_within
        while endoscope.stamp() < 0.0:
            if transport.clock() > until:
                raise InputError(_why_none(endoscope))
            time.sleep(ASK_AGAIN)
        return endoscope.left().image
    finally:
        transport.close()


def save_picture(image: Image, path: Path) -> None:
    """Write `image` (H, W, 3), RGB.

    Raises:
        InputError: the file's name is that of no picture, or it cannot be written.
    """
    try:
        written = cv2.imwrite(str(path), cv2.cvtColor(image, cv2.COLOR_RGB2BGR))
    except cv2.error:
        raise InputError(f"{path} is no name of a picture; end it with .png") from None
    if not written:
        raise InputError(f"{path} cannot be written; is its folder there?")


def _why_none(endoscope: EndoscopeDVRK) -> str:
    """What keeps pictures from coming, in one sentence."""
    if missing := endoscope.missing():
        return f"{', '.join(missing)}: nothing is published there; start the cameras, or correct rig and rectified in [camera]"
    endoscope.camera  # noqa: B018 - says what is wrong with the calibration
    unfit = "; ".join(endoscope.unfit())
    return unfit or "images come, but no two of them within max_skew of one another; look at the cameras' stamps"
