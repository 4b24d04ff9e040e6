"""Every public name resolves, has a docstring, and is documented to the end."""

import ast
import doctest
import inspect
from pathlib import Path

import pytest

import hexopt

ROOT = Path(__file__).resolve().parents[1]
NAMES = sorted(set(hexopt.__all__) - {"__version__"})


@pytest.mark.parametrize("name", NAMES)
class TestPublicNames:
    def test_it_resolves(self, name):
        assert getattr(hexopt, name) is getattr(hexopt, name)
        assert name in dir(hexopt)

    def test_it_has_a_docstring_of_its_own(self, name):
        thing = getattr(hexopt, name)
        text = vars(thing).get("__doc__") if inspect.isclass(thing) else thing.__doc__
        assert text
        assert len(text.split()) >= 3
        # a dataclass without docstring gets its signature as one
        assert not text.startswith(f"{name}(")

    def test_its_public_methods_have_docstrings(self, name):
        thing = getattr(hexopt, name)
        if not inspect.isclass(thing):
            return
        bare = [
            key
            for key, member in vars(thing).items()
            if not key.startswith("_")
            and (inspect.isfunction(member) or isinstance(member, (property, classmethod, staticmethod)))
            and not inspect.getdoc(getattr(member, "__func__", member))
        ]
        assert bare == []

    def test_its_examples_are_examples(self, name):
        """What stands under "Examples" holds a prompt, so that the doctests run it."""
        text = inspect.getdoc(getattr(hexopt, name)) or ""
        if "Examples\n---" in text:
            assert doctest.DocTestParser().get_examples(text.split("Examples\n---", 1)[1])


def test_an_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="module 'hexopt' has no attribute 'estimat'"):
        hexopt.estimat  # noqa: B018 - the access is the test


def test_names_are_listed_once_and_in_order():
    assert hexopt.__all__ == sorted(set(hexopt.__all__))


@pytest.mark.parametrize("path", sorted((ROOT / "hexopt").rglob("*.py")), ids=lambda path: str(path.relative_to(ROOT)))
def test_every_module_says_what_it_is_and_what_it_offers(path):
    """A docstring; and an `__all__` whose names exist, where there is anything to offer."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    assert ast.get_docstring(tree), f"{path} has no docstring"
    defined, offered = set(), None
    for node in tree.body:
        if isinstance(node, (ast.FunctionDef, ast.ClassDef)):
            defined.add(node.name)
        elif isinstance(node, (ast.Import, ast.ImportFrom)):
            defined.update(alias.asname or alias.name for alias in node.names)
        elif isinstance(node, (ast.Assign, ast.AnnAssign)):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            names = [item.id for target in targets for item in ast.walk(target) if isinstance(item, ast.Name)]
            defined.update(names)
            if "__all__" in names and isinstance(node.value, (ast.List, ast.Tuple)):
                offered = {ast.literal_eval(item) for item in node.value.elts}
    if path == ROOT / "hexopt" / "__init__.py" or (offered is None and not defined):
        return
    assert (offered or set()) <= defined
