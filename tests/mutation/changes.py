"""Small mistakes in a module: one operator, constant, comparison, index or argument is changed."""

import ast
from collections.abc import Iterator
from copy import deepcopy
from dataclasses import dataclass

OPERATORS: dict[type[ast.AST], type[ast.AST]] = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.FloorDiv: ast.Div,
    ast.Mod: ast.FloorDiv,
    ast.Pow: ast.Mult,
    ast.BitAnd: ast.BitOr,
    ast.BitOr: ast.BitAnd,
    ast.BitXor: ast.BitAnd,
    ast.LShift: ast.RShift,
    ast.RShift: ast.LShift,
    ast.And: ast.Or,
    ast.Or: ast.And,
}
COMPARISONS: dict[type[ast.AST], type[ast.AST]] = {
    ast.Lt: ast.LtE,
    ast.LtE: ast.Lt,
    ast.Gt: ast.GtE,
    ast.GtE: ast.Gt,
    ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq,
    ast.In: ast.NotIn,
    ast.NotIn: ast.In,
    ast.Is: ast.IsNot,
    ast.IsNot: ast.Is,
}
# Functions whose value does not depend on the order of their arguments.
SYMMETRIC = {"min", "max", "gcd", "lcm", "minimum", "maximum", "logaddexp", "allclose", "union"}
FUNCTIONS = (ast.FunctionDef, ast.AsyncFunctionDef, ast.Lambda)
DEFINITIONS = (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)


@dataclass(frozen=True)
class Change:
    """One change of a module: where it is, what it was and what it became."""

    kind: str
    where: str  # the function, "Class.method", or "" outside all of them
    before: str
    after: str
    lines: range  # those of its statement, without the statements inside
    at_import: bool  # it is run when the module is loaded

    @property
    def key(self) -> tuple[str, str, str]:
        """What names a change as long as its function stays as it is."""
        return self.where, self.before, self.after


def edits(node: ast.AST) -> Iterator[tuple[str, ast.AST]]:
    """Yield each kind of change of a node, and the node as it is after it."""

    def edited(**fields: object) -> ast.AST:
        other = deepcopy(node)
        for name, value in fields.items():
            setattr(other, name, value)
        return other

    match node:
        case ast.BinOp() | ast.AugAssign() | ast.BoolOp() if type(node.op) in OPERATORS:
            yield "operator", edited(op=OPERATORS[type(node.op)]())
        case ast.UnaryOp(op=ast.USub() | ast.Not() | ast.Invert()):
            yield "operator", node.operand
        case ast.Compare():
            for i, op in enumerate(node.ops):
                ops = [*node.ops[:i], COMPARISONS[type(op)](), *node.ops[i + 1 :]]
                yield "comparison", edited(ops=ops)
        case ast.Constant(value=bool() as value):
            yield "constant", edited(value=not value)
        case ast.Constant(value=int() | float() as number):
            yield "constant", edited(value=number + 1)
        case ast.Subscript(ctx=ast.Load(), slice=ast.Name() | ast.BinOp() | ast.Attribute()):
            before = ast.BinOp(node.slice, ast.Sub(), ast.Constant(1))
            yield "index", edited(slice=before)
        case ast.Subscript(value=ast.Name(id="dict" | "list" | "tuple" | "set")):
            pass  # a type
        case ast.Subscript(slice=ast.Tuple(elts=[first, second])):
            yield "index", edited(slice=ast.Tuple([second, first], ast.Load()))
        case ast.Call():
            name = ast.unparse(node.func).split(".")[-1]
            products = name == "map" and ast.unparse(node.args[0]) == "mul"
            pairs = range(0 if name in SYMMETRIC else 1 if products else len(node.args) - 1)
            for i in pairs:
                swapped = [*node.args[:i], node.args[i + 1], node.args[i], *node.args[i + 2 :]]
                if ast.Starred not in map(type, swapped):
                    yield "argument", edited(args=swapped)
            for i, keyword in enumerate(node.keywords):
                if keyword.arg not in (None, "strict"):  # `strict` only raises where lengths differ
                    rest = [*node.keywords[:i], *node.keywords[i + 1 :]]
                    yield "argument", edited(keywords=rest)


def is_left_out(node: ast.AST, field: str, outside: bool) -> bool:
    """Whether a part holds types, words or a check of lengths, which no number depends on."""
    types = field in ("annotation", "returns", "decorator_list", "bases", "type_params")
    words = isinstance(node, ast.Raise | ast.Assert | ast.JoinedStr)
    checked = isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"
    lengths = isinstance(node, ast.keyword) and node.arg == "strict"
    alias = outside and isinstance(node, ast.BinOp) and isinstance(node.op, ast.BitOr)
    return types or words or checked or lengths or alias


def changes(module: ast.Module) -> Iterator[Change]:
    """Yield the changes of a module; it holds each of them until the next is asked for."""

    def visit(
        parent: ast.AST, inside: tuple[str, ...], lines: range, at_import: bool
    ) -> Iterator[Change]:
        for field, value in ast.iter_fields(parent):
            for i, node in enumerate(value if isinstance(value, list) else [value]):
                if not isinstance(node, ast.AST) or is_left_out(node, field, not inside):
                    continue
                names = (*inside, node.name) if isinstance(node, DEFINITIONS) else inside
                own = lines_of(node) if isinstance(node, ast.stmt) else lines
                in_body = isinstance(parent, FUNCTIONS) and field == "body"
                loaded = at_import and not in_body
                for kind, other in edits(node):
                    put(parent, field, i, other)
                    texts = short(node), short(other)
                    yield Change(kind, ".".join(names), *texts, own, loaded)
                    put(parent, field, i, node)
                yield from visit(node, names, own, loaded)

    yield from visit(module, (), range(0), True)


def lines_of(statement: ast.stmt) -> range:
    """Return the lines of a statement, without those of the statements inside it."""
    body = getattr(statement, "body", None)
    last = body[0].lineno - 1 if body else statement.end_lineno or statement.lineno
    return range(statement.lineno, max(last, statement.lineno) + 1)


def put(parent: ast.AST, field: str, place: int, node: ast.AST) -> None:
    """Put a node into a field, or into its place of a list."""
    held = getattr(parent, field)
    before = held[place] if isinstance(held, list) else held
    ast.fix_missing_locations(ast.copy_location(node, before))
    if isinstance(held, list):
        held[place] = node
    else:
        setattr(parent, field, node)


def short(node: ast.AST) -> str:
    """Return the first line of a node's text."""
    return ast.unparse(node).splitlines()[0]
