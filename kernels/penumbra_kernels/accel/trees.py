"""Trees that were built before: what stands still between frames, and large meshes between runs, is not built again.

A tree is found by the content that it was built over: boxes, keys, leaf words, and the builders' own text. Nothing else
decides it, so a tree that is found is the tree that would have been built.
"""

from __future__ import annotations

import hashlib
import struct
from collections import OrderedDict
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from penumbra_kernels import cache as disk
from penumbra_kernels.accel.binary import SWEEP_LIMIT
from penumbra_kernels.accel.build import Items, Tree, build_tree, tree_from_bytes, tree_to_bytes

Build = Callable[[Items, NDArray[np.int64]], Tree]
KEPT_BYTES: Final = 64 * 1024 * 1024
"""Memory of the trees that one Trees keeps; those that were not used for longest go first."""


@cache
def _builders() -> bytes:
    """Digest of the modules that decide on a tree."""
    digest = hashlib.sha256()
    for name in ("binary.py", "binned.py", "wide.py", "build.py"):
        digest.update((Path(__file__).parent / name).read_bytes())
    return digest.digest()


def _key(items: Items, copies: NDArray[np.int64]) -> str:
    digest = hashlib.sha256(_builders())
    for array in (items.lo, items.hi, items.key, items.word, copies):
        digest.update(struct.pack("<Q", array.nbytes))
        digest.update(np.ascontiguousarray(array).view(np.uint8).data)
    return digest.hexdigest()


class Trees:
    """Builds trees, or finds them: in memory, and, those too large to be built at once, on disk.

    One that lives as long as a sequence of frames builds what does not move once. Not for several threads.
    """

    def __init__(self, kept_bytes: int = KEPT_BYTES, build_large: Build = build_tree) -> None:
        """build_large: builds over more than SWEEP_LIMIT items."""
        self.kept_bytes = kept_bytes
        self._build_large = build_large
        self.built = 0
        """Trees that had to be built."""
        self._kept: OrderedDict[str, Tree] = OrderedDict()

    def tree(self, items: Items, copies: NDArray[np.int64]) -> Tree:
        """As build_tree(items, copies)."""
        key = _key(items, copies)
        tree = self._kept.pop(key, None)
        if tree is None:
            tree = self._from_disk_or_built(key, items, copies)
        self._keep(key, tree)
        return tree

    def _from_disk_or_built(self, key: str, items: Items, copies: NDArray[np.int64]) -> Tree:
        large = len(items.lo) > SWEEP_LIMIT
        data = disk.load(key) if large else None
        if data is not None:
            return tree_from_bytes(data)
        self.built += 1
        tree = (self._build_large if large else build_tree)(items, copies)
        if large:
            disk.store(key, tree_to_bytes(tree))
        return tree

    def _keep(self, key: str, tree: Tree) -> None:
        if tree.bytes > self.kept_bytes:
            return
        self._kept[key] = tree
        while sum(kept.bytes for kept in self._kept.values()) > self.kept_bytes:
            self._kept.popitem(last=False)
