"""Writes the measured part of docs/numerics.md: every hard case on this machine's devices. Run by `make numerics`."""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from collections import defaultdict
from pathlib import Path
from typing import Any

PAGE = Path(__file__).resolve().parent.parent / "docs" / "numerics.md"
BEGIN, END = "<!-- measured by `make numerics`: begin -->", "<!-- end -->"


def measured(fast: bool) -> dict[str, Any]:
    """What the self-test says."""
    command = [
        sys.executable,
        "-W",
        "ignore",
        "-m",
        "penumbra_kernels.hardcases",
        "--json",
        *([] if fast else ["--full"]),
    ]
    result = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=False)
    if not result.stdout:
        sys.exit("the self-test said nothing")
    answer: dict[str, Any] = json.loads(result.stdout)
    return answer


def number(value: float) -> str:
    """Two digits; exact where it is a small integer."""
    if value == int(value) and abs(value) < 1e4:
        return str(int(value))
    return f"{value:.2g}"


def telling(outcome: dict[str, Any]) -> list[str]:
    """The numbers nearest to their bounds, each kind once: what stands before a measure's first comma is its kind."""
    kinds: dict[str, list[dict[str, Any]]] = defaultdict(list)
    for m in outcome["measures"]:
        if not m["coverage"]:
            kinds[m["what"].split(",")[0].split(" [")[0]].append(m)
    lines = []
    for of_kind in kinds.values():
        worst = max(of_kind, key=strain)
        sign = "≥" if worst["at_least"] else "≤"
        lines.append(f"{number(worst['value'])} {sign} {number(worst['bound'])} {worst['what']}")
    return lines[:5]


def strain(measure: dict[str, Any]) -> float:
    """How near to its bound."""
    a, b = measure["value"], measure["bound"]
    if measure["at_least"]:
        a, b = b, a
    return float("inf") if not measure["passed"] else a / b if b > 0 else 0.0


def row(outcome: dict[str, Any]) -> str:
    """One line of the table."""
    state = "" if outcome["status"] == "passed" else f"**{outcome['status']}** {outcome['message']} "
    cells = [
        str(outcome["number"]),
        f"**{outcome['name']}**: {outcome['sentence']}",
        outcome["oracle"],
        state + "<br>".join(telling(outcome)),
        outcome["algorithm"],
    ]
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"


def processor() -> str:
    """Model and family, as Linux tells them."""
    try:
        lines = dict(
            line.split(":", 1) for line in Path("/proc/cpuinfo").read_text().split("\n\n")[0].splitlines()
        )
    except (OSError, ValueError):
        return ""
    told = {key.strip(): value.strip() for key, value in lines.items()}
    return f", on {told.get('model name', 'a processor')} (family {told.get('cpu family', '?')})"


def tables(answer: dict[str, Any]) -> str:
    """A table a device."""
    parts = []
    for device in answer["devices"]:
        mine = [o for o in answer["outcomes"] if o["device"] == device["id"]]
        passed = sum(o["status"] == "passed" for o in mine)
        setting = "with all samples (`--full`)" if answer["full"] else "in the fast setting"
        parts.append(
            f"`{device['id']}`, {device['name']}, driver {device['driver']}{processor()}: {passed} of {len(mine)} cases keep "
            f"their bounds, {setting}.\n\n"
            "| | case | oracle | measured, and its bound | what is done |\n|---|---|---|---|---|\n"
            + "\n".join(row(outcome) for outcome in mine)
        )
    return "\n\n".join(parts)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--fast", action="store_true", help="fewer samples")
    answer = measured(parser.parse_args().fast)
    page = PAGE.read_text()
    before, _, rest = page.partition(BEGIN)
    _, _, after = rest.partition(END)
    PAGE.write_text(f"{before}{BEGIN}\n\n{tables(answer)}\n\n{END}{after}")
    return 0 if answer["passed"] else 1


if __name__ == "__main__":
    sys.exit(main())
