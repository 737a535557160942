"""The certificate by which the processes of one local run know each other.

It never lies on a disk: it is handed from memory to memory.
"""

from __future__ import annotations

from datetime import UTC, datetime, timedelta

from cryptography import x509
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.hashes import SHA256
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat
from distributed.security import Security

DAYS = 3650  # no run takes longer


def make_security() -> Security:
    """Return what lets processes that were given it connect to each other, and nobody else."""
    name = x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, "demflow")])
    private, now = ec.generate_private_key(ec.SECP256R1()), datetime.now(UTC)
    draft = x509.CertificateBuilder(name, name, private.public_key(), x509.random_serial_number())
    draft = draft.not_valid_before(now - timedelta(1)).not_valid_after(now + timedelta(DAYS))
    certificate = draft.sign(private, SHA256()).public_bytes(Encoding.PEM).decode()
    key = private.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()).decode()
    files = {"tls_ca_file": certificate}
    for role in ("client", "scheduler", "worker"):
        files |= {f"tls_{role}_cert": certificate, f"tls_{role}_key": key}
    return Security(require_encryption=True, **files)
