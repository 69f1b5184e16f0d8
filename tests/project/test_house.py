"""The rules of the house: how large a piece of code may be, and what its signature says."""

import ast
from pathlib import Path

import pytest

import tss_ros

PACKAGE = Path(tss_ros.__file__).parent
MODULES = sorted(path.relative_to(PACKAGE).as_posix() for path in PACKAGE.rglob("*.py"))
MOST_MODULE_LINES, MOST_FUNCTION_LINES, MOST_POSITIONAL = 400, 80, 8


def functions():
    """(module, class or None, node) of every function of the package, inner ones included."""
    for module in MODULES:
        tree = ast.parse((PACKAGE / module).read_text(encoding="utf-8"))
        yield from found_in(tree, module, None)


def found_in(parent, module, owner):
    for node in ast.iter_child_nodes(parent):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            yield module, owner, node
        inner = node if isinstance(node, ast.ClassDef) else None
        yield from found_in(node, module, inner)


def own_parameters(owner, node):
    """A function's positional parameters, without a method's first one."""
    static = any(isinstance(d, ast.Name) and d.id == "staticmethod" for d in node.decorator_list)
    positional = node.args.posonlyargs + node.args.args
    return positional[1:] if owner is not None and not static else positional


def test_no_module_is_too_long():
    lines = {m: len((PACKAGE / m).read_text(encoding="utf-8").splitlines()) for m in MODULES}
    assert {m: n for m, n in lines.items() if n > MOST_MODULE_LINES} == {}


def test_no_function_is_too_long():
    lines = {
        (module, node.name): node.end_lineno - node.lineno + 1 for module, _, node in functions()
    }
    assert {key: n for key, n in lines.items() if n > MOST_FUNCTION_LINES} == {}


def test_no_function_has_too_many_positional_parameters():
    counts = {
        (module, node.name): len(own_parameters(owner, node)) for module, owner, node in functions()
    }
    assert {key: n for key, n in counts.items() if n > MOST_POSITIONAL} == {}


def is_public(owner, node):
    """Whether a function can be reached from outside: the names of it and of its class say so."""
    hidden = node.name.startswith("_") and node.name != "__init__"
    return not hidden and not (owner is not None and owner.name.startswith("_"))


def outermost(module):
    """(class or None, function) of a module's functions and of its classes' methods."""
    tree = ast.parse((PACKAGE / module).read_text(encoding="utf-8"))
    for owner in (None, *(node for node in tree.body if isinstance(node, ast.ClassDef))):
        for node in (owner or tree).body:
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                yield owner, node


def is_compiled(node):
    """Whether a function is a kernel, whose types numba finds."""
    text = " ".join(ast.unparse(decorator) for decorator in node.decorator_list)
    words = ("njit", "kernel", "allocating", "inlined", "leaf", "intrinsic")
    return any(word in text for word in words)


@pytest.mark.parametrize("module", MODULES)
def test_public_functions_say_what_types_they_take_and_give(module):
    lacking = []
    for owner, node in outermost(module):
        arguments = node.args
        others = (*arguments.kwonlyargs, arguments.vararg, arguments.kwarg)
        parameters = [*own_parameters(owner, node), *filter(None, others)]
        missing = [p.arg for p in parameters if p.annotation is None]
        if node.returns is None and node.name != "__init__":
            missing.append("what it returns")
        if missing and is_public(owner, node) and not is_compiled(node):
            lacking.append(f"line {node.lineno}, {node.name}: {', '.join(missing)}")
    assert lacking == []


def test_type_checkers_are_told_of_the_hints():
    assert (PACKAGE / "py.typed").is_file()
