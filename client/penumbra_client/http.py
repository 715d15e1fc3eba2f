"""One place where HTTP happens: addresses, keys, and failures turned into the client's own errors."""

from __future__ import annotations

import ipaddress
import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Final, TypeVar

import httpx
from penumbra_scene.base import Model
from penumbra_scene.errors import Problem
from pydantic import ValidationError

from penumbra_client.errors import ClientError, RefusedError, UnreachableError

DEFAULT_SERVER: Final = "http://127.0.0.1:8484"
_TIMEOUT: Final = httpx.Timeout(30.0, connect=5.0)
"""Seconds. The service answers at once; a long wait means that it is gone."""
_Document = TypeVar("_Document", bound=Model)


def server_address(given: str | None) -> str:
    """The service's address: as given, or PENUMBRA_SERVER, or this machine's."""
    address = (given or os.environ.get("PENUMBRA_SERVER") or DEFAULT_SERVER).rstrip("/")
    url = _parse(address)
    if url is None or url.scheme not in ("http", "https") or not url.host:
        raise ClientError(
            f"the service's address is {address!r}; accepted: http://host:port or https://host:port"
        )
    return address


def _parse(address: str) -> httpx.URL | None:
    try:
        return httpx.URL(address)
    except httpx.InvalidURL:
        return None


def _is_loopback(address: str) -> bool:
    host = httpx.URL(address).host
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


class Connection:
    """An httpx client with our errors. `transport` is for tests."""

    def __init__(
        self,
        server: str | None = None,
        api_key: str | None = None,
        transport: httpx.BaseTransport | None = None,
    ) -> None:
        self.server = server_address(server)
        key = api_key or os.environ.get("PENUMBRA_API_KEY")
        self._http = httpx.Client(
            base_url=self.server,
            headers={"Authorization": f"Bearer {key}"} if key else {},
            timeout=_TIMEOUT,
            transport=transport,
            # A proxy is for the world outside, never for this machine's own service.
            trust_env=not _is_loopback(self.server),
        )

    def close(self) -> None:
        """Give the sockets back."""
        self._http.close()

    def send(self, method: str, path: str, **options: Any) -> httpx.Response:
        """An answer below 400. Raises UnreachableError and RefusedError."""
        with self._told():
            response = self._http.request(method, path, **options)
        raise_refused(response)
        return response

    def document(self, model: type[_Document], method: str, path: str, **options: Any) -> _Document:
        """An answer as a model."""
        return self.read(model, self.send(method, path, **options).content)

    def read(self, model: type[_Document], data: str | bytes) -> _Document:
        """What the service said, as a model. Raises ClientError where it makes no sense at all.

        Keys that this version does not know are left out: the service may be newer.
        """
        try:
            return model.model_validate_json(data, extra="ignore")
        except ValidationError as error:
            raise ClientError(
                f"{self.server} speaks another API: {error.error_count()} errors in {model.__name__}"
            ) from error

    @contextmanager
    def stream(self, method: str, path: str, **options: Any) -> Iterator[httpx.Response]:
        """An answer below 400 whose body is read piece by piece. Raises UnreachableError and RefusedError."""
        with self._told(), self._http.stream(method, path, **options) as response:
            if response.status_code >= httpx.codes.BAD_REQUEST:
                response.read()
                raise_refused(response)
            yield response

    @contextmanager
    def _told(self) -> Iterator[None]:
        try:
            yield
        except httpx.TransportError as error:
            raise UnreachableError(self.server, str(error) or type(error).__name__) from error


def raise_refused(response: httpx.Response) -> None:
    """Turn an error answer into RefusedError."""
    if response.status_code >= httpx.codes.BAD_REQUEST:
        raise RefusedError(_problem(response))


def _problem(response: httpx.Response) -> Problem:
    """The problem that the service tells, or one made up for an answer that is none, such as a proxy's."""
    try:
        return Problem.model_validate(json.loads(response.content), extra="ignore")
    except (ValueError, ValidationError):
        phrase = response.reason_phrase or "error"
        return Problem(
            type="about:blank",
            title=f"{response.status_code} {phrase}",
            status=min(max(response.status_code, 400), 599),
            detail=f"{response.request.method} {response.request.url}",
        )
