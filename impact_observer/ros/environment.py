# SPDX-License-Identifier: Apache-2.0
"""The environment variables of ROS, checked before ROS reads them.

ROS compares words exactly, ignores other words without a message, and ends some processes itself.
"""

import ctypes
import os
from collections.abc import Sequence
from contextlib import suppress
from itertools import pairwise
from pathlib import Path

from impact_observer.errors import UsageError

SECURITY = "ROS_SECURITY_ENABLE"
_STRATEGY = "ROS_SECURITY_STRATEGY"
_KEYSTORE = "ROS_SECURITY_KEYSTORE"
_ENCLAVE = "ROS_SECURITY_ENCLAVE_OVERRIDE"
_DOMAIN = "ROS_DOMAIN_ID"
_LAST_DOMAIN = 232
"""Largest domain for which Fast DDS has ports."""
_MIDDLEWARE = ("RMW_IMPLEMENTATION", "RCL_ASSERT_RMW_ID_MATCHES")
_LIBRARIES = ("librmw_implementation.so", "librmw_fastrtps_cpp.so")
"""Libraries that know the middleware: the choosing one of an installed ROS, that of the wheels."""


def check_environment(args: Sequence[str] = ()) -> None:
    """Check domain, middleware and security of a process with the arguments ``args``.

    Raises:
        UsageError: naming the variable, its value and what is expected.
    """
    domain = os.environ.get(_DOMAIN, "")
    if domain and not (domain.isascii() and domain.isdigit() and int(domain) <= _LAST_DOMAIN):
        raise UsageError(
            f"{_DOMAIN}: {domain[:40]} found; expected a whole number from 0 to {_LAST_DOMAIN}"
        )
    security_warning(args)
    _check_middleware()


def security_warning(args: Sequence[str] = ()) -> str:
    """Check the security that is asked for; return why a node may run without, if it may.

    Args:
        args: the arguments of the node, which may name its enclave.

    Raises:
        UsageError: ROS would run without security though security is asked for.
    """
    enabled, strategy = os.environ.get(SECURITY, ""), os.environ.get(_STRATEGY, "")
    if enabled not in {"true", "false", ""}:
        raise UsageError(f"{SECURITY}: {enabled} found; expected true, false or empty")
    if enabled != "true":
        return ""
    if strategy not in {"Enforce", "Permissive"}:
        raise UsageError(
            f"{_STRATEGY}: {strategy or 'nothing'} found with {SECURITY}=true; expected Enforce,"
            " or Permissive to run without security where no enclave is found"
        )
    missing = _missing_enclave(args)
    if strategy == "Enforce" and missing:
        raise UsageError(f"{missing}; docs/security.md says how to make one")
    if strategy == "Enforce":
        return ""
    found = f"runs without: {missing}" if missing else "has found its enclave; others need none"
    return f"{_STRATEGY}: Permissive enforces no security; this node {found}"


def _missing_enclave(args: Sequence[str]) -> str:
    """Why a node has no enclave, by the rules of ROS; empty if the node has one."""
    keystore = os.environ.get(_KEYSTORE, "")
    if not keystore:
        return f"{_KEYSTORE}: nothing found; expected the folder of a keystore"
    given = [value for flag, value in pairwise(args) if flag in {"--enclave", "-e"}]
    name = os.environ.get(_ENCLAVE) or (given[-1] if given else "/")
    if not Path(keystore, "enclaves", name.lstrip("/")).is_dir():
        return f"{_KEYSTORE}: {keystore} has no enclave {name}; expected one (--enclave NAME)"
    return ""


def _check_middleware() -> None:
    """Check that the middleware is the one asked for, as ROS ends the process if it is another."""
    wanted = {each: os.environ.get(each, "") for each in _MIDDLEWARE}
    if not any(wanted.values()):
        return
    for library in _LIBRARIES:
        with suppress(OSError, AttributeError):
            identifier = ctypes.CDLL(library).rmw_get_implementation_identifier
            identifier.restype = ctypes.c_char_p
            found = (identifier() or b"").decode()
            break
    else:
        return
    for name, value in wanted.items():
        if value and value != found:
            usable = f"{found} or empty" if found else "a middleware that is installed, or empty"
            raise UsageError(f"{name}: {value} found; expected {usable}")
