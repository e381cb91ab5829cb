"""The ROS 1 classes of a message or service: from the installed packages, or for crtk_msgs made of our own definitions.

Debian has no crtk_msgs. A class made by genpy from the same text has the same md5 sum and the same bytes on the wire.
"""

from __future__ import annotations

import importlib
import re
from functools import cache
from typing import Any

import genmsg
import genpy.dynamic

from hardware.dvrk.crtk_definitions import MD5, MESSAGES, SERVICES
from hardware.dvrk.transport import TransportError

_BETWEEN = "\n" + "=" * 80 + "\n"  # how ROS separates a definition from those that it uses
_USED = re.compile(r"^(\w+/\w+)(?:\[\d*\])?\s+\w+", re.MULTILINE)


@cache
def message_class(ros: str) -> Any:
    """The class of message `ros` ("pkg/Name").

    Raises:
        TransportError: its package is missing, or defines it otherwise than the dVRK does.
    """
    found = _installed(ros, "msg")
    if found is None:
        found = _made(ros, MESSAGES[ros])
    return _checked(ros, found)


@cache
def service_class(ros: str) -> Any:
    """The class of service `ros` ("pkg/Name"), with its `_request_class` and `_response_class`.

    Raises:
        TransportError: its package is missing, or defines it otherwise than the dVRK does.
    """
    found = _installed(ros, "srv")
    return _checked(ros, _made_service(ros) if found is None else found)


def _installed(ros: str, folder: str) -> Any:
    package, name = ros.split("/")
    try:
        return getattr(importlib.import_module(f"{package}.{folder}"), name)
    except (ImportError, AttributeError):
        if ros in MESSAGES or ros in SERVICES:
            return None
        debian = package.replace("_", "-")
        raise TransportError(
            f"this machine has no {ros} of ROS 1; install it, on Debian by `apt-get install python3-{debian}`"
        ) from None


def _checked(ros: str, found: Any) -> Any:
    expected = MD5.get(ros, found._md5sum)
    if found._md5sum != expected:
        raise TransportError(
            f"this machine defines {ros} otherwise than dVRK 2.2 and newer (md5 {found._md5sum}, not {expected}); install crtk_msgs 1.3"
        )
    return found


def _made_service(ros: str) -> Any:
    question, answer = re.split(r"^---\n", SERVICES[ros], flags=re.MULTILINE)
    request, response = (_made(f"{ros}{half}", text) for half, text in (("Request", question), ("Response", answer)))
    context = genmsg.MsgContext.create_default()
    for text in (question, answer):
        for used, definition in _used(text).items():
            context.register(used, genmsg.msg_loader.load_msg_from_string(context, definition, used))
    spec = genmsg.msg_loader.load_srv_from_string(context, SERVICES[ros], ros)
    md5 = genmsg.gentools.compute_md5(context, spec)
    return type(ros.split("/")[1], (), {"_type": ros, "_md5sum": md5, "_request_class": request, "_response_class": response})


def _made(ros: str, text: str) -> Any:
    whole = _BETWEEN.join([text, *(f"MSG: {used}\n{definition}" for used, definition in _used(text).items())])
    return genpy.dynamic.generate_dynamic(ros, whole)[ros]


def _used(text: str) -> dict[str, str]:
    """The definitions of every type that `text` uses, theirs too."""
    found: dict[str, str] = {}
    for ros in _USED.findall(text):
        if ros in MESSAGES:
            found |= {ros: MESSAGES[ros], **_used(MESSAGES[ros])}
            continue
        found[ros], *further = message_class(ros)._full_text.split(_BETWEEN)
        for one in further:
            line, _, definition = one.partition("\n")
            found[line.removeprefix("MSG: ").strip()] = definition
    return found
