"""Count lines and habits of the code: python benchmarks/code_size.py [CHECKOUT]."""

import ast
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(sys.argv[1] if len(sys.argv) > 1 else Path(__file__).resolve().parents[1])
WING = ("baselines", "benchmark")
#: Attributes of a model, guide or fit that hold a part; asking whether one is None is a dispatch.
PARTS = {"emission", "edges", "rule", "transition", "guide", "parameters_guide", "initial"}


def sources(folder: str) -> Iterator[tuple[Path, str]]:
    """Yield path, from the checkout's root, and text of each Python file."""
    for path in sorted((ROOT / folder).rglob("*.py")):
        yield path.relative_to(ROOT), path.read_text(encoding="utf-8")


def part_classes() -> set[str]:
    """Return the classes of models and guides: what a dispatch on type asks for."""
    names = set()
    for folder in ("swarmssm/models", "swarmssm/inference"):
        for _, text in sources(folder):
            names |= {
                node.name for node in ast.walk(ast.parse(text)) if isinstance(node, ast.ClassDef)
            }
    return names


def asks_for_none(node: ast.AST) -> bool:
    """Return whether a comparison asks if a part is None."""
    return (
        isinstance(node, ast.Compare)
        and isinstance(node.ops[0], ast.Is | ast.IsNot)
        and isinstance(node.comparators[0], ast.Constant)
        and node.comparators[0].value is None
        and isinstance(node.left, ast.Attribute)
        and node.left.attr in PARTS
    )


def main() -> None:
    """Print all counts."""
    lines: Counter[str] = Counter()
    counts: Counter[str] = Counter()
    parts = part_classes()
    exported: dict[str, set[str]] = {}
    public: dict[str, list[str]] = {}
    modules = set()
    for path, text in sources("swarmssm"):
        room = path.parts[1]
        lines["wing" if room in WING else "core"] += text.count("\n")
        lines[f"  {'/'.join(path.parts[1:-1][:2]) or '(top)'}"] += text.count("\n")
        counts["files over 450 lines"] += text.count("\n") > 450
        name = ".".join(path.with_suffix("").parts).removesuffix(".__init__")
        modules.add(name)
        tree = ast.parse(text)
        if path.name == "__init__.py":
            exported[name] = {
                str(element.value)
                for node in ast.walk(tree)
                if isinstance(node, ast.Assign)
                and any(isinstance(t, ast.Name) and t.id == "__all__" for t in node.targets)
                and isinstance(node.value, ast.List | ast.Tuple)
                for element in node.value.elts
                if isinstance(element, ast.Constant)
            }
        for node in tree.body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                public.setdefault(node.name, []).append(name)
        for node in ast.walk(tree):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
                if node.func.id in ("getattr", "hasattr"):
                    counts["getattr, hasattr"] += 1
                if node.func.id == "isinstance":
                    asked = {n.id for n in ast.walk(node.args[1]) if isinstance(n, ast.Name)}
                    counts["isinstance of a part"] += bool(asked & parts)
            counts["None of a part"] += asks_for_none(node)
    lines["tests"] = sum(text.count("\n") for _, text in sources("tests"))
    shadowed = [
        f"{package}.{n}"
        for package, names in exported.items()
        for n in names
        if f"{package}.{n}" in modules
    ]
    # Functions and classes only: a package may well list its own submodules.
    functions = {
        f"{package}.{name}"
        for package in exported
        for path, text in sources("swarmssm")
        if ".".join(path.with_suffix("").parts).removesuffix(".__init__") == package
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.ImportFrom)
        for name in (alias.asname or alias.name for alias in node.names)
        if f"{node.module}.{name}" not in modules
    }
    counts["submodules shadowed"] = len(set(shadowed) & functions)
    twice = {name: where for name, where in public.items() if len(where) > 1}
    counts["public classes of one name"] = len(twice)
    for name, number in lines.items():
        print(f"{number:7,d}  {name}")
    for name, number in counts.items():
        print(f"{number:7,d}  {name}")
    print("shadowed:", ", ".join(sorted(set(shadowed) & functions)) or "none")
    print("of one name:", "; ".join(f"{n} ({', '.join(w)})" for n, w in twice.items()) or "none")


if __name__ == "__main__":
    main()
