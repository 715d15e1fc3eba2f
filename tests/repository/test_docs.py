"""The documents say what is there: links lead somewhere, commands exist, all exit statuses are told."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest
from penumbra_client.cli import BUILT_IN
from penumbra_scene.exits import Exit

ROOT = Path(__file__).resolve().parents[2]
DOCUMENTS = sorted(
    path
    for path in [*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md"), *ROOT.glob("examples/*.md")]
    if path.is_file()
)
_LINK = re.compile(r"\]\(([^)\s]+)\)")
_TARGET = re.compile(r"^([a-z-]+):.*##", re.MULTILINE)


def _commands() -> set[str]:
    points = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["entry-points"][
        "penumbra.commands"
    ]
    return {*BUILT_IN, *points}


def _anchors(document: Path) -> set[str]:
    """What GitHub makes of headings."""
    headings = re.findall(r"^#+ (.*)$", document.read_text(), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: str(path.relative_to(ROOT)))
def test_links_lead_somewhere(document: Path) -> None:
    for link in _LINK.findall(document.read_text()):
        if re.match(r"[a-z]+:", link):
            continue
        name, _, anchor = link.partition("#")
        target = (document.parent / name).resolve() if name else document
        assert target.exists(), f"{document.name} links to {link}"
        assert not anchor or anchor in _anchors(target), f"{document.name} links to {link}"


def _code(document: Path) -> str:
    """What stands in code, in blocks and in lines, each piece on lines of its own."""
    pieces = re.findall(r"```sh\n(.*?)```|`([^`\n]+)`", document.read_text(), re.DOTALL)
    return "\n".join(block or line for block, line in pieces)


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: str(path.relative_to(ROOT)))
def test_make_targets_that_are_named_exist(document: Path) -> None:
    targets = set(_TARGET.findall((ROOT / "Makefile").read_text()))
    lines = re.findall(r"^\s*make ((?:[a-z-]+(?: |$))+)", _code(document), re.MULTILINE)
    assert {word for line in lines for word in line.split()} <= targets


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: str(path.relative_to(ROOT)))
def test_commands_that_are_named_exist(document: Path) -> None:
    named = set(re.findall(r"(?:^|`|\$\()penumbra ([a-z]+)", document.read_text(), re.MULTILINE))
    assert named <= _commands()


def test_the_command_line_document_lists_every_command() -> None:
    listed = re.findall(r"^\| `penumbra ([a-z]+)` \|", (ROOT / "docs" / "cli.md").read_text(), re.MULTILINE)
    assert sorted(listed) == sorted(_commands())


def test_the_command_line_document_tells_every_exit_status() -> None:
    listed = re.findall(r"^\| (\d+) \|", (ROOT / "docs" / "cli.md").read_text(), re.MULTILINE)
    assert [int(status) for status in listed] == sorted(Exit)


def test_the_command_line_document_says_what_the_client_alone_cannot_do() -> None:
    told = (
        (ROOT / "docs" / "cli.md").read_text().split("The client alone installs", 1)[1].split("\n## ", 1)[0]
    )
    missing = [name for name in sorted(_commands() - set(BUILT_IN)) if f"`{name}`" not in told]
    assert not missing


def test_no_change_is_told_twice() -> None:
    """Branches that both append to the file are merged by union, which can keep two forms of a line."""
    lines = [line for line in (ROOT / "CHANGELOG.md").read_text().splitlines() if line.startswith("- ")]
    begins = [line[:60] for line in lines]
    assert [begin for begin in set(begins) if begins.count(begin) > 1] == []


def test_every_decision_is_listed_in_order() -> None:
    folder = ROOT / "docs" / "decisions"
    listed = re.findall(r"\]\((\d{4}-[a-z0-9-]+\.md)\)", (folder / "README.md").read_text())
    assert listed == sorted(path.name for path in folder.glob("[0-9]*.md"))
    numbers = [int(name[:4]) for name in listed]
    assert len(set(numbers)) == len(numbers)
    for number, name in zip(numbers, listed, strict=True):
        assert (folder / name).read_text().startswith(f"# {number}. ")
