"""API keys. Only a SHA-256 of each is stored: a key has 256 random bits, so guessing needs no slowing
down."""

from __future__ import annotations

import hashlib
import secrets
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any, Final

from sqlalchemy import func, insert, or_, select, update

from penumbra_service.store.database import Database
from penumbra_service.store.ids import new_id
from penumbra_service.store.schema import api_keys

PREFIX: Final = "pnb_"
RANDOM_BYTES: Final = 32
HINT_LENGTH: Final = 8
"""Characters of a key that are kept readable, so that a person can tell two apart."""


MAX_NAME: Final = 200


class KeyNameError(ValueError):
    """A key cannot have this name; the message says why, and what is accepted."""


@dataclass(frozen=True)
class ApiKey:
    """What is known of a key; the key itself is shown once, when it is made."""

    id: str
    name: str
    hint: str
    created: datetime
    revoked: datetime | None
    quota_seconds: float | None = None
    """Device-seconds that its jobs may use in all; None: as many as they like."""
    used_seconds: float = 0.0
    """Device-seconds that its jobs have used."""

    @property
    def exhausted(self) -> bool:
        """Whether no more jobs are accepted from it."""
        return self.quota_seconds is not None and self.used_seconds >= self.quota_seconds


def _digest(token: str) -> bytes:
    return hashlib.sha256(token.encode()).digest()


def _key(row: Any) -> ApiKey:
    return ApiKey(row.id, row.name, row.hint, row.created, row.revoked, row.quota_seconds, row.used_seconds)


def _named(id_or_name: str) -> Any:
    return or_(api_keys.c.id == id_or_name, api_keys.c.name == id_or_name)


class KeyStore:
    """Makes, checks and revokes keys."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def create(self, name: str, quota_seconds: float | None = None) -> tuple[str, ApiKey]:
        """A new key: its text, which is not kept, and what is. Raises KeyNameError.

        Active keys have different names, so that to revoke one by its name ends no other.
        """
        if not 1 <= len(name) <= MAX_NAME or not name.isprintable():
            accepted = f"1 to {MAX_NAME} printable characters"
            raise KeyNameError(f"a key's name: given {name[:80]!r}, accepted: {accepted}")
        token = PREFIX + secrets.token_urlsafe(RANDOM_BYTES)
        key = ApiKey(new_id(), name, token[:HINT_LENGTH], datetime.now(UTC), None, quota_seconds)
        namesake = select(api_keys.c.id).where(api_keys.c.name == name, api_keys.c.revoked.is_(None))
        with self._database.write() as connection:
            if connection.execute(namesake).first() is not None:
                raise KeyNameError(
                    f"there is an active key {name!r} already: choose another name, or revoke it"
                )
            connection.execute(
                insert(api_keys).values(
                    id=key.id,
                    name=name,
                    hint=key.hint,
                    created=key.created,
                    digest=_digest(token),
                    quota_seconds=quota_seconds,
                    used_seconds=0.0,
                )
            )
        return token, key

    def admit(self, name: str, token: str) -> None:
        """Let in a key that was made elsewhere; nothing happens where it is known, revoked or not."""
        known = select(api_keys.c.id).where(api_keys.c.digest == _digest(token))
        with self._database.write() as connection:
            if connection.execute(known).first() is None:
                row = {
                    "id": new_id(),
                    "name": name,
                    "hint": token[:HINT_LENGTH],
                    "created": datetime.now(UTC),
                }
                connection.execute(insert(api_keys).values(**row, digest=_digest(token)))

    def check(self, token: str) -> ApiKey | None:
        """The key that this text is, if it exists and is not revoked. Digests are compared: timing tells
        nothing."""
        query = select(api_keys).where(api_keys.c.digest == _digest(token), api_keys.c.revoked.is_(None))
        with self._database.read() as connection:
            row = connection.execute(query).one_or_none()
        return None if row is None else _key(row)

    def get(self, key_id: str) -> ApiKey | None:
        """The key with this identifier."""
        with self._database.read() as connection:
            row = connection.execute(select(api_keys).where(api_keys.c.id == key_id)).one_or_none()
        return None if row is None else _key(row)

    def set_quota(self, id_or_name: str, quota_seconds: float | None) -> int:
        """Limits the device-seconds of the active keys with this identifier or name; None lifts the limit. How many
        keys those were."""
        change = update(api_keys).where(_named(id_or_name), api_keys.c.revoked.is_(None))
        with self._database.write() as connection:
            return connection.execute(change.values(quota_seconds=quota_seconds)).rowcount

    def charge(self, key_id: str, device_seconds: float) -> None:
        """Its jobs have used so much more."""
        change = update(api_keys).where(api_keys.c.id == key_id)
        with self._database.write() as connection:
            connection.execute(change.values(used_seconds=api_keys.c.used_seconds + device_seconds))

    def revoke(self, id_or_name: str) -> int:
        """Ends the key with this identifier, or all with this name; how many that were."""
        change = (
            update(api_keys)
            .where(_named(id_or_name), api_keys.c.revoked.is_(None))
            .values(revoked=datetime.now(UTC))
        )
        with self._database.write() as connection:
            return connection.execute(change).rowcount

    def list(self) -> list[ApiKey]:
        """Every key, the oldest first, revoked ones too."""
        with self._database.read() as connection:
            return [_key(row) for row in connection.execute(select(api_keys).order_by(api_keys.c.id))]

    def any_active(self) -> bool:
        """Whether any key was made and not revoked."""
        query = select(func.count()).select_from(api_keys).where(api_keys.c.revoked.is_(None))
        with self._database.read() as connection:
            return connection.execute(query).scalar_one() > 0

    def any_made(self) -> bool:
        """Whether any key was ever made: a service that had keys does not fall open when they are revoked."""
        with self._database.read() as connection:
            return connection.execute(select(func.count()).select_from(api_keys)).scalar_one() > 0
