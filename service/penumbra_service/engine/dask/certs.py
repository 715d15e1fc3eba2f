"""`penumbra certs`: a certificate authority of a farm's own, and a certificate for each of its roles.

The farm's TLS is mutual: scheduler, workers and the service each show a certificate of this authority and take no other.
Names of machines are not looked at (Dask checks none), so that a role's certificate works wherever the role runs; to
have one is to be let in. Keys are ECDSA P-256; files are readable by their owner only.
"""

from __future__ import annotations

import os
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Final

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

ROLES: Final = ("scheduler", "worker", "client")
DEFAULT_DAYS: Final = 365
_SKEW: Final = timedelta(hours=1)
"""Certificates are valid from a little earlier: clocks of machines differ."""

Key = ec.EllipticCurvePrivateKey


class CertsExistError(FileExistsError):
    """The folder has an authority already."""


def make_certs(folder: Path, days: int = DEFAULT_DAYS) -> list[Path]:
    """Make an authority and a certificate for each role in `folder`; the files.

    Raises CertsExistError, OSError.
    """
    if (folder / "ca.pem").exists():
        raise CertsExistError(f"{folder} has certificates already: remove them, or name another folder")
    folder.mkdir(parents=True, exist_ok=True, mode=0o700)
    key = ec.generate_private_key(ec.SECP256R1())
    name = _name("Penumbra farm authority")
    authority = _certificate(name, name, key, key, days, authority=True)
    files = [_write(folder / "ca.pem", _pem(authority)), _write(folder / "ca-key.pem", _key_pem(key))]
    for role in ROLES:
        own = ec.generate_private_key(ec.SECP256R1())
        certificate = _certificate(_name(f"Penumbra {role}"), name, own, key, days, authority=False)
        files += [
            _write(folder / f"{role}.pem", _pem(certificate)),
            _write(folder / f"{role}-key.pem", _key_pem(own)),
        ]
    return files


def _name(common: str) -> x509.Name:
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, common)])


def _certificate(
    subject: x509.Name, issuer: x509.Name, own: Key, signer: Key, days: int, *, authority: bool
) -> x509.Certificate:
    now = datetime.now(UTC)
    builder = (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer)
        .public_key(own.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - _SKEW)
        .not_valid_after(now + timedelta(days=days))
        .add_extension(
            x509.BasicConstraints(ca=authority, path_length=0 if authority else None), critical=True
        )
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(own.public_key()), critical=False)
        .add_extension(
            x509.AuthorityKeyIdentifier.from_issuer_public_key(signer.public_key()), critical=False
        )
        .add_extension(_usage(authority), critical=True)
    )
    if not authority:
        both = [ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH]
        builder = builder.add_extension(x509.ExtendedKeyUsage(both), critical=False)
    return builder.sign(signer, hashes.SHA256())


def _usage(authority: bool) -> x509.KeyUsage:
    return x509.KeyUsage(
        digital_signature=not authority,
        key_cert_sign=authority,
        crl_sign=authority,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        encipher_only=False,
        decipher_only=False,
    )


def _pem(certificate: x509.Certificate) -> bytes:
    return certificate.public_bytes(serialization.Encoding.PEM)


def _key_pem(key: Key) -> bytes:
    return key.private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    )


def _write(path: Path, data: bytes) -> Path:
    """Readable by nobody else at any moment."""
    with os.fdopen(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb") as file:
        file.write(data)
    return path
