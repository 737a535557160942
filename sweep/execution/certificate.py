"""The certificate by which the processes of one local run know each other.

A process of its own makes it, which is this file run as a program: what it takes to make one,
10 MB, would stay in memory as long as the run.
"""

from __future__ import annotations

import sys
from datetime import UTC, datetime, timedelta
from multiprocessing.spawn import get_executable
from subprocess import PIPE, Popen, TimeoutExpired

DAYS = 3650  # no run takes longer
MAKING_SECONDS = 60.0  # after which a certificate comes no more
_begun: list[Popen[str]] = []  # the process that makes the next one


def begin() -> None:
    """Have the next certificate made meanwhile: it takes some time of another core."""
    if not _begun:
        program = [get_executable(), "-P", __file__, *sys.path]
        # in a group of its own, where it hears no Ctrl-C
        _begun.append(Popen(program, stdout=PIPE, stderr=PIPE, text=True, process_group=0))


def made() -> tuple[str, str]:
    """Return a certificate that vouches for itself and its key, both as PEM. Raises RunError."""
    from demflow.sweep.errors import RunError  # the program may not find it

    begin()
    making = _begun.pop()
    try:
        told, why = making.communicate(timeout=MAKING_SECONDS)
    except TimeoutExpired:
        making.kill()
        told, why = making.communicate()
    if making.returncode:
        why = why.strip() or f"its process ended with status {making.returncode}"
        raise RunError(f"no certificate could be made for the workers: {why}")
    certificate, key = told.split("\0")
    return certificate, key


def forget() -> None:
    """End a process whose certificate nobody asked for."""
    while _begun:
        with _begun.pop() as making:
            making.kill()


def _make() -> tuple[str, str]:
    from cryptography import x509
    from cryptography.hazmat.primitives.asymmetric import ec
    from cryptography.hazmat.primitives.hashes import SHA256
    from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat

    name = x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, "demflow")])
    private, now = ec.generate_private_key(ec.SECP256R1()), datetime.now(UTC)
    draft = x509.CertificateBuilder(name, name, private.public_key(), x509.random_serial_number())
    draft = draft.not_valid_before(now - timedelta(1)).not_valid_after(now + timedelta(DAYS))
    certificate = draft.sign(private, SHA256()).public_bytes(Encoding.PEM).decode()
    key = private.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()).decode()
    return certificate, key


if __name__ == "__main__":
    sys.path[:] = sys.argv[1:]
    print(*_make(), sep="\0", end="")
