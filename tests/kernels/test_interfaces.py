"""What kernels read of the objects handed to them is what the folder's `interfaces.py` declares, no less and no more.

A folder of `kernels/` declares in `interfaces.py` a Protocol for each kind of object, a line for each attribute with its shape
and unit, and in `READS` which Protocol a parameter of a name has; a module that means something else by a name has a `READS` of
its own. What no folder says is what `kernels/interfaces.py` says, for all of them. Every parameter annotated `ti.template()` of
which anything is read must be there. Source is read, not run: `solver.pairs.contact[c].depth` uses `pairs` of the solver's
Protocol, `row` of that of `pairs`, and `depth` of that of `row`, whose Protocol describes one entry of the table.
"""

import ast
from pathlib import Path

import pytest

pytestmark = pytest.mark.once

KERNELS = Path(__file__).resolve().parents[2] / "kernels"
PACKAGE = "taichi_sim.kernels"


class Declarations:
    """All Protocols, by name, and which one a parameter of a module has."""

    def __init__(self, sources):
        """sources: the text of each module by its dotted name below `kernels`."""
        self.attributes, self.bases, self.where, self.reads, self.undescribed = {}, {}, {}, {}, []
        self.trees = {name: ast.parse(text) for name, text in sources.items()}
        for name, tree in self.trees.items():
            self.reads[name] = read_table(tree)
            if name.split(".")[-1] == "interfaces":
                for node in tree.body:
                    if isinstance(node, ast.ClassDef):
                        self._declare(name, node, sources[name].splitlines())

    def _declare(self, module, node, lines):
        assert node.name not in self.attributes, f"{module}: {node.name} is declared twice"
        self.where[node.name] = module
        self.bases[node.name] = [base.id for base in node.bases if isinstance(base, ast.Name) and base.id != "Protocol"]
        own = self.attributes[node.name] = {}
        for item in node.body:
            if isinstance(item, ast.AnnAssign):
                own[item.target.id] = annotated(item.annotation)
                if not any("#" in line for line in lines[item.lineno - 1 : item.end_lineno]):
                    self.undescribed.append(f"{module}: {node.name}.{item.target.id}")
            elif isinstance(item, ast.FunctionDef):
                own[item.name] = annotated(item.returns)
                if ast.get_docstring(item) is None:
                    self.undescribed.append(f"{module}: {node.name}.{item.name}")

    def home(self, kind, attribute):
        """The Protocol, this one or one that it builds on, that declares an attribute; None if none does."""
        if attribute in self.attributes[kind]:
            return kind
        return next((home for base in self.bases[kind] if (home := self.home(base, attribute))), None)

    def serves(self, kind, wanted):
        """Whether what has the Protocol `kind` has `wanted` too."""
        return kind == wanted or any(self.serves(base, wanted) for base in self.bases[kind])

    def of_parameter(self, module, name):
        """The Protocol of a parameter, or None."""
        folder = ".".join([*module.split(".")[:-1], "interfaces"])
        places = (module, folder, "interfaces")
        return next((self.reads[place][name] for place in places if name in self.reads.get(place, {})), None)


def read_table(tree):
    """The names in `READS = {"parameter": Protocol, ...}` of a module."""
    for node in tree.body:
        if isinstance(node, (ast.Assign, ast.AnnAssign)) and ast.unparse(node).startswith("READS"):
            return {key.value: value.id for key, value in zip(node.value.keys, node.value.values)}
    return {}


def annotated(node):
    """The one name in an annotation, as text or not; None for what is more than a name."""
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        return node.value
    return node.id if isinstance(node, ast.Name) else None


class Reader(ast.NodeVisitor):
    """Collects what one function reads; types follow assignments of names."""

    def __init__(self, declared, module, function, functions, imported):
        self.declared, self.module, self.function = declared, module, function
        self.functions, self.imported = functions, imported
        self.used, self.faults = set(), []
        self.kinds = {a.arg: declared.of_parameter(module, a.arg) for a in function.args.args}
        self.templates = templates(function)
        for statement in function.body:
            self.visit(statement)

    def fault(self, node, text):
        self.faults.append(f"{self.module}:{node.lineno} {self.function.name}: {text}")

    def kind(self, node):
        """The Protocol of an expression, or None."""
        if isinstance(node, ast.Name):
            return self.kinds.get(node.id)
        if isinstance(node, ast.Subscript):
            return self.kind(node.value)
        if isinstance(node, ast.Attribute):
            owner = self.kind(node.value)
            home = self.declared.home(owner, node.attr) if owner else None
            found = self.declared.attributes[home][node.attr] if home else None
            return found if found in self.declared.attributes else None
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
            if ast.unparse(node.func) == "ti.static":
                return self.kind(node.args[0])
            return self.kind(node.func)
        return None

    def visit_Attribute(self, node):
        self.generic_visit(node)
        owner = self.kind(node.value)
        if owner:
            home = self.declared.home(owner, node.attr)
            if home is None:
                self.fault(node, f"reads .{node.attr}, which {owner} does not declare")
            else:
                self.used.add((home, node.attr))
        elif (base := root(node.value)) in self.templates and self.kinds.get(base) is None:
            self.fault(node, f"reads .{node.attr} of `{base}`, for which READS names no Protocol")

    def visit_Assign(self, node):
        self.generic_visit(node)
        for target in node.targets:
            pairs = [(target, node.value)]
            if isinstance(target, ast.Tuple):
                values = (
                    node.value.elts if isinstance(node.value, ast.Tuple) else [ast.Constant(None)] * len(target.elts)
                )
                pairs = list(zip(target.elts, values))
            for name, value in pairs:
                if isinstance(name, ast.Name):
                    self.kinds[name.id] = self.kind(value)

    def visit_For(self, node):
        if isinstance(node.target, ast.Name):
            self.kinds[node.target.id] = self.kind(node.iter)
        self.generic_visit(node)

    def visit_Call(self, node):
        self.generic_visit(node)
        called = self.imported.get(ast.unparse(node.func), (self.module, ast.unparse(node.func)))
        function = self.functions.get(called)
        if function is None:
            return
        names = [argument.arg for argument in function.args.args]
        for name, value in [*zip(names, node.args), *((k.arg, k.value) for k in node.keywords)]:
            given, wanted = self.kind(value), self.declared.of_parameter(called[0], name)
            if name in templates(function) and given and wanted and not self.declared.serves(given, wanted):
                self.fault(node, f"hands a {given} to {called[1]}, whose `{name}` is a {wanted}")


def root(node):
    """The name that a chain of subscripts begins with."""
    while isinstance(node, ast.Subscript):
        node = node.value
    return node.id if isinstance(node, ast.Name) else None


def templates(function):
    """Parameters that are annotated with a template."""
    return {a.arg for a in function.args.args if a.annotation and ast.unparse(a.annotation) == "ti.template()"}


def imported_functions(module, trees):
    """What a module calls an imported function, and the module and name where that is defined."""
    found = {}
    for node in ast.walk(trees[module]):
        if isinstance(node, ast.ImportFrom) and node.module.startswith(PACKAGE):
            below = node.module[len(PACKAGE) + 1 :]
            for alias in node.names:
                name, whole = alias.asname or alias.name, f"{below}.{alias.name}".lstrip(".")
                found[name] = (below, alias.name)
                for item in trees[whole].body if whole in trees else ():
                    if isinstance(item, ast.FunctionDef):
                        found[f"{name}.{item.name}"] = (whole, item.name)
    return found


def examine(sources):
    """Faults of all modules, and the declared attributes that nobody reads."""
    declared = Declarations(sources)
    functions = {
        (module, node.name): node
        for module, tree in declared.trees.items()
        for node in tree.body
        if isinstance(node, ast.FunctionDef)
    }
    used, faults = set(), [f"{text} has no shape and unit" for text in declared.undescribed]
    for (module, _), function in functions.items():
        reader = Reader(declared, module, function, functions, imported_functions(module, declared.trees))
        used |= reader.used
        faults += reader.faults
    for kind, attributes in declared.attributes.items():
        unused = [name for name in attributes if (kind, name) not in used]
        faults += [f"{declared.where[kind]}: {kind}.{name} is read by no kernel" for name in unused]
    return faults


def kernel_sources():
    """The text of every module of `kernels`, by its dotted name below it."""
    paths = sorted(KERNELS.rglob("*.py"))
    return {".".join(path.relative_to(KERNELS).with_suffix("").parts): path.read_text("utf-8") for path in paths}


def test_kernels_read_what_is_declared():
    assert all((path.parent / "interfaces.py").exists() for path in KERNELS.glob("*/__init__.py"))
    assert examine(kernel_sources()) == []


DECLARED = """
class Row(Protocol):
    depth: Field  # m, overlap
class Solver(Protocol):
    row: Row  # (contacts)
    n: int  # balls
    def apply(self, i, p):
        "v += w p"
READS = {"solver": Solver, "row": Row}
"""
KERNEL = """
from taichi_sim.kernels.a.other import grow
@ti.func
def solve(solver: ti.template(), i):
    row = solver.row[i]
    solver.apply(i, row.depth)
    grow(solver.row, solver.n)
"""
OTHER = """
@ti.func
def grow(row: ti.template(), n):
    row[n].depth = 0.0
"""


@pytest.mark.parametrize(
    ("part", "old", "new", "fault"),
    [
        ("solve", "", "", None),
        ("solve", "row.depth", "row.width", "reads .width, which Row does not declare"),
        ("solve", "solver.n)", "solver.n + solver.m)", "reads .m, which Solver does not declare"),
        ("solve", "grow(solver.row", "grow(solver", "hands a Solver to grow, whose `row` is a Row"),
        ("solve", "solver.apply(i, row.depth)", "pass", "Solver.apply is read by no kernel"),
        ("other", "row", "table", "reads .depth of `table`, for which READS names no Protocol"),
        ("interfaces", "  # balls", "", "Solver.n has no shape and unit"),
    ],
)
def test_the_comparison_finds_what_is_wrong(part, old, new, fault):
    sources = {"a.interfaces": DECLARED, "a.solve": KERNEL, "a.other": OTHER}
    sources[f"a.{part}"] = sources[f"a.{part}"].replace(old, new) if old else sources[f"a.{part}"]
    faults = examine(sources)
    assert len(faults) == (fault is not None)
    assert fault is None or fault in faults[0]
