"""Tokens of definitions: what numbers may depend on in a module's syntax tree, as `benchmarks/definitions.py` says."""

import ast
from collections.abc import Iterator
from functools import cache
from typing import NamedTuple

SENTENCE = 3  # words


class Reference(NamedTuple):
    """A name that is not local, with the attributes after it, as it stands in a definition."""

    name: str
    attributes: tuple[str, ...] = ()
    keyword: str = ""
    """A keyword of a call of what is referred to; "" for the reference itself."""


class Module(NamedTuple):
    """What a module binds: tokens of each definition, parameters of each function, and its imports."""

    tokens: dict[str, tuple]
    parameters: dict[str, tuple[str, ...]]
    imports: dict[str, tuple[str, str]]


def bound_names(statement: ast.stmt) -> set[str]:
    """The names that a statement at the top level of a module binds or changes; empty for a docstring or an import."""
    if isinstance(statement, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
        return {statement.name}
    found, todo = set(), [statement]
    while todo:
        node = todo.pop()
        if isinstance(node, ast.Lambda | ast.ListComp | ast.SetComp | ast.DictComp | ast.GeneratorExp):
            continue
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Call):
            base = node.value.func
            base = base.value if isinstance(base, ast.Attribute) else None
            found |= {base.id} if isinstance(base, ast.Name) else set()
        elif isinstance(node, ast.Name | ast.Attribute | ast.Subscript) and isinstance(node.ctx, ast.Store):
            while not isinstance(node, ast.Name) and hasattr(node, "value"):
                node = node.value
            found |= {node.id} if isinstance(node, ast.Name) else set()
            continue
        todo.extend(ast.iter_child_nodes(node))
    return found


def local_names(node: ast.AST, inside: bool = False) -> Iterator[str]:
    """Names that are bound within the functions, lambdas and comprehensions of a statement."""
    if isinstance(node, ast.Name):
        if inside and isinstance(node.ctx, ast.Store):
            yield node.id
    elif isinstance(node, ast.arg):
        yield node.arg
    elif isinstance(node, ast.ExceptHandler) and inside and node.name:
        yield node.name
    nested = isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda)
    if isinstance(node, ast.FunctionDef) and inside:
        yield node.name
    if isinstance(node, ast.ClassDef):
        inside = False  # what a class binds are attributes
    for child in ast.iter_child_nodes(node):
        yield from local_names(child, inside or nested or isinstance(node, ast.comprehension))


class Tokens:
    """The tokens of one definition: texts, and references to be resolved."""

    def __init__(self, statements: list[ast.stmt]):
        self.found: list[str | Reference] = []
        self.local = {name for statement in statements for name in local_names(statement)}
        self.numbers: dict[str, int] = {}
        for statement in statements:
            self.add(statement, top=True)

    def name(self, name: str) -> None:
        """A local name by its number in order of appearance, any other as a reference."""
        if name in self.local:
            self.found.append(f"local {self.numbers.setdefault(name, len(self.numbers))}")
        else:
            self.found.append(Reference(name))

    def add(self, node, top=False, in_class=False) -> None:
        """Everything of a node that numbers may depend on."""
        if isinstance(node, list):
            self.found.append("[")
            for each in node:
                self.add(each, in_class=in_class)
            self.found.append("]")
        elif isinstance(node, ast.AST):
            special = getattr(self, f"_{type(node).__name__}", None)
            if special is None:
                self.generic(node)
            elif type(node).__name__ in ("FunctionDef", "ClassDef"):
                special(node, top, in_class)
            else:
                special(node)
        else:
            self.found.append(repr(node))

    def generic(self, node) -> None:
        """The kind of a node and its fields."""
        self.found.append(type(node).__name__)
        for field, value in ast.iter_fields(node):
            if field not in ("ctx", "kind", "type_comment", "annotation", "returns", "type_params"):
                self.add(value)

    def _FunctionDef(self, node, top, in_class) -> None:  # noqa: N802
        self.found.append("def")
        if not top:
            self.found.append(node.name) if in_class else self.name(node.name)
        for part in (node.decorator_list, node.args, node.body):
            self.add(part)

    def _ClassDef(self, node, top, in_class) -> None:  # noqa: N802
        self.found.append("class")
        for part in (node.decorator_list, node.bases, node.keywords):
            self.add(part)
        self.add(node.body, in_class=True)

    def _Import(self, node) -> None:  # noqa: N802
        """Nothing: what is imported counts where it is used."""

    _ImportFrom = _Import

    def _Name(self, node) -> None:  # noqa: N802
        self.name(node.id)

    def _arg(self, node) -> None:
        self.name(node.arg)

    def _ExceptHandler(self, node) -> None:  # noqa: N802
        self.add([node.type, node.body])

    def _Constant(self, node) -> None:  # noqa: N802
        text = isinstance(node.value, str) and "\n" not in node.value and len(node.value.split()) >= SENTENCE
        self.found.append("sentence" if text else repr(node.value))

    def _Expr(self, node) -> None:  # noqa: N802
        value = node.value
        printed = isinstance(value, ast.Call) and isinstance(value.func, ast.Name) and value.func.id == "print"
        if not (printed or isinstance(value, ast.Constant)):
            self.add(value)

    def _Raise(self, node) -> None:  # noqa: N802
        self.found.append("raise")
        self.add(node.exc.func if isinstance(node.exc, ast.Call) else node.exc)

    def _Assert(self, node) -> None:  # noqa: N802
        self.found.append("assert")
        self.add(node.test)

    def _Attribute(self, node) -> None:  # noqa: N802
        reference = self.dotted(node)
        if reference is None:
            self.add(node.value)
            self.found.append(f".{node.attr}")
        else:
            self.found.append(reference)

    def _Call(self, node) -> None:  # noqa: N802
        self.found.append("call")
        self.add([node.func, node.args])
        reference = self.dotted(node.func)
        for keyword in node.keywords:
            if reference is None or keyword.arg is None:
                self.found.append(repr(keyword.arg))
            else:
                self.found.append(reference._replace(keyword=keyword.arg))
            self.add(keyword.value)

    def dotted(self, node) -> Reference | None:
        """The reference that `name.attribute. ...` is, unless it begins with a local name or something else."""
        attributes = []
        while isinstance(node, ast.Attribute):
            attributes.append(node.attr)
            node = node.value
        if isinstance(node, ast.Name) and node.id not in self.local:
            return Reference(node.id, tuple(reversed(attributes)))
        return None


@cache
def parsed(name: str, package: bool, source: str) -> Module:
    """A module by its source."""
    tree = ast.parse(source)
    here = name.split(".") if package else name.split(".")[:-1]
    imports: dict[str, tuple[str, str]] = {}
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            for alias in node.names:
                imports[alias.asname or alias.name.split(".")[0]] = (
                    alias.name if alias.asname else alias.name.split(".")[0],
                    "",
                )
        elif isinstance(node, ast.ImportFrom):
            base = here[: len(here) - node.level + 1] if node.level else []
            origin = ".".join([*base, *([node.module] if node.module else [])])
            imports |= {alias.asname or alias.name: (origin, alias.name) for alias in node.names}
    statements: dict[str, list[ast.stmt]] = {}
    parameters = {}
    for statement in tree.body:
        if isinstance(statement, ast.Import | ast.ImportFrom):
            continue
        for bound in sorted(bound_names(statement)) or [""]:
            statements.setdefault(bound, []).append(statement)
        if isinstance(statement, ast.FunctionDef):
            args = statement.args
            parameters[statement.name] = tuple(a.arg for a in (*args.posonlyargs, *args.args, *args.kwonlyargs))
    tokens = {bound: tuple(Tokens(group).found) for bound, group in statements.items()}
    return Module(tokens, parameters, imports)
