"""Digests of code: equal for two definitions that compute the same in the same way, whatever they are called.

A definition is what a module binds at its top level: a function, a class, a constant. Its digest is made of its syntax
tree and of the digests of the definitions that it refers to, in this repository, wherever they stand.

Not seen, because numbers do not depend on it: comments, docstrings, annotations, `print`, what is raised but its type,
sentences (strings of three words or more on one line), names of modules, functions, constants, parameters and local
variables, and the file a definition stands in. Seen: everything else, among it names of attributes, methods and
fields, other strings, and the keywords of calls whose function is not found.

Cannot be seen: what is reached without a name of Python, such as an environment made by its id, or an attribute looked
up by a computed name (a module that is used as a value counts as a whole); a global name that is also a local one
elsewhere in the same definition; data files; other packages and their versions; the processor. What depends on such
things has to name them: see `benchmarks/registry.py`.
"""

from collections.abc import Collection, Mapping
from functools import cached_property

from benchmarks.tokens import Reference, parsed

ROUNDS = 6  # references deep that a digest covers; all that is reached is compared, so that a change anywhere is seen
WHOLE = "*"
"""The name that stands for everything a module binds."""


class Code:
    """The definitions of many modules.

    Args:
        sources: text of each module by its dotted name; a package by "name.__init__".
        ignored: modules and "module:name" that no number depends on: references to them are not followed.
    """

    def __init__(self, sources: Mapping[str, str], ignored: Collection[str] = ()):
        self.ignored = frozenset(ignored)
        self.modules = {
            name.removesuffix(".__init__"): parsed(name.removesuffix(".__init__"), name.endswith(".__init__"), source)
            for name, source in sources.items()
        }

    def lookup(self, module: str, name: str, seen: frozenset = frozenset()) -> tuple[str, str] | None:
        """Key (module, name) of what a module calls `name`; (module, "*") for a module; None if it is not here."""
        if not name:
            return (module, WHOLE) if module in self.modules else None
        record = self.modules.get(module)
        if record is None or (module, name) in seen:
            return None
        if name in record.tokens:
            return module, name
        found = None
        if name in record.imports:
            found = self.lookup(*record.imports[name], seen | {(module, name)})
        inner = f"{module}.{name}"
        return found or ((inner, WHOLE) if inner in self.modules else None)

    def resolve(self, module: str, reference: Reference) -> tuple[tuple[str, str] | None, tuple[str, ...]]:
        """Key of what a reference within a module means, None if it is not here, and the attributes that are left."""
        key, left = self.lookup(module, reference.name), reference.attributes
        while key is not None and key[1] == WHOLE and left:
            inner = self.lookup(key[0], left[0])
            if inner is None:
                break
            key, left = inner, left[1:]
        return key, left

    def expanded(self, key: tuple[str, str]) -> tuple[tuple, tuple]:
        """Of a definition: its tokens with a mark for each reference, and the keys that are referred to, in order."""
        module, name = key
        record = self.modules[module]
        if name == WHOLE:
            return tuple(record.tokens), tuple((module, each) for each in record.tokens)
        tokens, keys = [], []
        for token in record.tokens[name]:
            if isinstance(token, str):
                tokens.append(token)
                continue
            found, left = self.resolve(module, token)
            if found and not self.ignored.isdisjoint((found[0], ":".join(found))):
                tokens.append("ignored")
            elif token.keyword:
                known = self.modules[found[0]].parameters.get(found[1], ()) if found and not left else ()
                tokens.append(known.index(token.keyword) if token.keyword in known else token.keyword)
            elif found is None:
                origin = record.imports.get(token.name, (token.name, ""))
                tokens.append((*origin, *token.attributes))
            else:
                tokens.append(("reference", *left))
                keys.append(found)
        return tuple(tokens), tuple(keys)

    @cached_property
    def graph(self) -> dict[tuple[str, str], tuple[tuple, tuple]]:
        """Every definition by its key, expanded."""
        keys = [(module, name) for module, record in self.modules.items() for name in (*record.tokens, WHOLE)]
        return {key: self.expanded(key) for key in keys}

    @cached_property
    def own(self) -> dict[tuple[str, str], int]:
        """Digest of the tokens of every definition, whatever it refers to."""
        return {key: hash(tokens) for key, (tokens, _) in self.graph.items()}

    @cached_property
    def digests(self) -> dict[tuple[str, str], int]:
        """Digest of every definition; comparable within one process."""
        own = found = self.own
        for _ in range(ROUNDS):
            found = {
                key: hash((own[key], *[found[other] for other in others])) for key, (_, others) in self.graph.items()
            }
        return found

    def reached(self, keys) -> set[tuple[str, str]]:
        """All definitions that these refer to, themselves included.

        Raises:
            KeyError: if one of them does not exist.
        """
        found, todo = set(), list(keys)
        while todo:
            key = todo.pop()
            if key not in found:
                found.add(key)
                todo.extend(self.graph[key][1])
        return found

    def changes(self, keys, before: "Code") -> list[tuple[str, str]]:
        """The definitions reached from these that did not exist before.

        Only those whose own tokens are new; if there are none, those that refer to other definitions than before.
        """
        known, texts = set(before.digests.values()), set(before.own.values())
        changed = [key for key in sorted(self.reached(keys)) if self.digests[key] not in known]
        return [key for key in changed if self.own[key] not in texts] or changed
