"""What else is wrong with a scenario that its schema refuses: the mistakes that do not hang on what it refuses.

The refused entries are replaced in two ways, as unlike as the schema lets them be, and both files are built. What both
are refused for, word for word, is wrong whatever these entries were meant to be; the rest may only follow from them.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from pydantic import ValidationError

from workbench.scenario.document import Node, Path, closest, locate, plain
from workbench.scenario.schema import ScenarioFile
from workbench.scenario.wrong import literals

__all__ = ["independent"]

ROUNDS = 200  # an entry takes one for each stand-in, and so does each that holds it

# What stands in for a refused entry: the first that the schema takes. The entry is there in both, as it is in the file;
# a mapping holds what it must in the one, and all that it may in the other.
_ABSENT = object()
_SPARSE: tuple[Any, ...] = (1, "1 s", "a", False, [1, 2], ["1 s", "2 s"], [], {}, _ABSENT)
_AMPLE: tuple[Any, ...] = (2, "20 s", "b", True, [2, 3], ["20 s", "30 s"], {}, [], _ABSENT)


def independent(root: Node, refused: Callable[[ScenarioFile], list[tuple[Path, str]]]) -> list[tuple[Path, str]]:
    """Return what is refused (path, text) of a file whose schema refuses something, whatever that was meant to be.

    refused: what stands against a file that its schema takes.
    """
    mends = [_Mend(root, ample=False), _Mend(root, ample=True)]
    files = [mend.file() for mend in mends]
    found: list[list[tuple[Path, str]]] = []
    for file in files:
        if file is None:
            return []
        found.append(refused(file))
    touched = mends[0].touched | mends[1].touched
    holders = mends[0].holders | mends[1].holders

    def own(path: Path) -> bool:
        real = locate(root, path)[1]
        for other in touched:
            least = min(len(real), len(other))
            if real[:least] == other[:least] or path[: len(other)] == other:
                return False
        # What is missing may be what an unknown key was meant for, or what stood in a mapping that was refused.
        return not holders or (real not in holders and real[-1:] == path[-1:])

    return [(path, text) for path, text in found[0] if (path, text) in found[1] and own(path)]


class _Mend:
    """One way of replacing what the schema refuses. touched: the paths replaced.

    holders: mappings that had unknown keys, or stand in for what was refused.
    """

    def __init__(self, root: Node, *, ample: bool) -> None:
        self.data: Any = plain(root)
        self.ample = ample
        self.tries: dict[Path, int] = {}
        self.touched: set[Path] = set()
        self.holders: set[Path] = set()
        self.made: list[tuple[Path, dict[Any, Any]]] = []  # mappings that stand in

    def file(self) -> ScenarioFile | None:
        """Return the file as the schema takes it; None where no replacement is found."""
        for _ in range(ROUNDS):
            allowed: dict[int, tuple[str, ...]] = {}
            try:
                file = ScenarioFile.model_validate(self.data, context=allowed)
                if not self._filled(allowed):
                    return file
            except ValidationError as error:
                # All of a round refer to the data as they were: what is replaced meanwhile is for the next one.
                done: list[Path] = []
                for one in error.errors(include_url=False, include_input=False):
                    path = self._real(one)
                    if any(path[: len(other)] == other for other in done):
                        continue
                    placed = self._replace(path, one, allowed)
                    if placed is None:
                        return None
                    done.append(placed)
        return None

    def _filled(self, allowed: dict[int, tuple[str, ...]]) -> bool:
        """Give the mappings that were made all that they may hold, so that no default is in both files."""
        added = False
        for path, holder in self.made if self.ample else ():
            for name in allowed.get(id(holder), ()):
                if name not in holder and (*path, name) not in self.tries:
                    self.tries[(*path, name)] = 0
                    holder[name] = _AMPLE[0]
                    added = True
        self.made = []
        return added

    def _real(self, error: Any) -> Path:
        """Return where in the data an error stands, passing over what leads nowhere as `locate` does."""
        at: Any = self.data
        path: list[str | int] = []
        for element in error["loc"]:
            listed = isinstance(at, list) and isinstance(element, int) and 0 <= element < len(at)
            if listed or (isinstance(at, dict) and element in at):
                at = at[element]
                path.append(element)
        if error["type"] == "missing":
            path.append(error["loc"][-1])
        return tuple(path)

    def _at(self, path: Path) -> Any:
        at = self.data
        for element in path:
            at = at[element]
        return at

    def _replace(self, path: Path, error: Any, allowed: dict[int, tuple[str, ...]]) -> Path | None:
        """Replace what an error is about, and return its path; None where nothing is left to be tried."""
        kind, context = str(error["type"]), error.get("ctx") or {}
        self.touched.add(path)
        if kind == "variant":
            self._vary(path, str(error["msg"]).split("|"))
            return path
        if path and (kind == "extra_forbidden" or error["loc"][-1:] == ("[key]",)):
            holder = self._at(path[:-1])
            value = holder.pop(path[-1])
            self.holders.add(path[:-1])
            near = closest(path[-1], tuple(name for name in allowed.get(id(holder), ()) if name not in holder))
            if self.ample and near:
                holder[near] = value
            return path
        if kind == "literal_error" and path not in self.tries:
            words = literals(str(context.get("expected", "")))
            self.tries[path] = -1
            self.touched.add(path[:-1])  # what stands beside a choice may suit the one that was meant alone
            self._put(path, words[-1 if self.ample else 0])
            return path
        stand_ins = _AMPLE if self.ample else _SPARSE
        while path:
            if not isinstance(self._at(path[:-1]), dict | list):
                path = path[:-1]  # a name that stands for a mapping
                continue
            number = self.tries[path] = self.tries.get(path, -1) + 1
            if number < len(stand_ins):
                self.touched.add(path)
                self._put(path, stand_ins[number])
                return path
            path = path[:-1]
        return None

    def _vary(self, path: Path, said: list[str]) -> None:
        """Make a mapping of one variant of what is none."""
        key, *variants = said
        name = variants[min(int(self.ample), len(variants) - 1)]
        given = self._at(path)
        kept = dict(given) if isinstance(given, dict) else {}
        if key:
            kept[key] = name
        else:
            kept.setdefault(name, None)
        self._put(path, kept)

    def _put(self, path: Path, value: object) -> None:
        fresh = list(value) if isinstance(value, list) else dict(value) if isinstance(value, dict) else value
        if isinstance(fresh, dict):
            self.made.append((path, fresh))
            self.holders.add(path)
        if not path:
            self.data = fresh
            return
        holder = self._at(path[:-1])
        if fresh is not _ABSENT:
            holder[path[-1]] = fresh
        elif isinstance(holder, dict):
            holder.pop(path[-1], None)
        else:
            holder[path[-1]] = None
