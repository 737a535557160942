"""The certificate by which the processes of one local run know each other.

It is made in a process of its own, since the library that makes it takes 10 MB, and is handed
from memory to memory.
"""

from __future__ import annotations

import subprocess
import sys

from distributed.security import Security

DAYS = 3650  # no run takes longer


def make_security() -> Security:
    """Return what lets processes that were given it connect to each other, and nobody else."""
    command = [sys.executable, "-I", "-c", _MAKE]
    made = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    begin = made.index("-----BEGIN PRIVATE")
    certificate, key = made[:begin], made[begin:]
    files = {"tls_ca_file": certificate}
    for role in ("client", "scheduler", "worker"):
        files |= {f"tls_{role}_cert": certificate, f"tls_{role}_key": key}
    return Security(require_encryption=True, **files)


_MAKE = f"""
from datetime import datetime, timedelta, timezone
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
name = x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, "demflow")])
key, now = ec.generate_private_key(ec.SECP256R1()), datetime.now(timezone.utc)
made = x509.CertificateBuilder().subject_name(name).issuer_name(name).public_key(key.public_key())
made = made.serial_number(x509.random_serial_number()).not_valid_before(now - timedelta(1))
made = made.not_valid_after(now + timedelta({DAYS})).sign(key, hashes.SHA256())
pem = serialization.Encoding.PEM
plain = serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
print((made.public_bytes(pem) + key.private_bytes(pem, *plain)).decode())
"""
