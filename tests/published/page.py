"""The page docs/published.md: a table of the figures that the published tests measured, and a paragraph for each test."""

import inspect
import re
from collections.abc import Iterable
from importlib import import_module
from pathlib import Path
from types import ModuleType

FOLDER = Path(__file__).parent
OTHERS = ("__main__", "common", "elasticity", "gas", "page", "test_all")  # files that measure nothing
PAGE = FOLDER.parents[1] / "docs" / "published.md"
HEAD = """# Published tests

Problems with a known solution from the literature, run with the defaults of the program: Verlet, automatic step, single
precision, on the CPU. Each reference is a formula or an independent numerical solution in NumPy and SciPy. Each file in
`tests/published/` is one test. `make published` measures all of them again and writes this page.

- **error**: found less reference, in percent of the reference (of the scene's scale where the reference is 0).
- **allowed**: the largest error with which the test passes.
- **finer**: the error with a shorter step or a finer mesh.
- **double**: the error at the defaults in double precision; means of random starts have none.
"""


def modules(names: Iterable[str] = ()) -> dict[str, ModuleType]:
    """Test modules by name, those in `names` or all of them."""
    files = {file.stem.removeprefix("test_"): file.stem for file in FOLDER.glob("*.py") if file.stem not in OTHERS}
    chosen = sorted(files.keys() & set(names) if names else files)
    return {name: import_module(f"tests.published.{files[name]}") for name in chosen}


def title_and_text(module: ModuleType) -> tuple[str, str]:
    """Return the first line of a module's docstring without its full stop, and the rest as one paragraph."""
    title, _, text = inspect.getdoc(module).partition("\n")
    return title.rstrip("."), " ".join(text.split())


def percent(error: float) -> str:
    """Write an error with two significant digits, in percent."""
    size = 100 * abs(error)
    return "0" if size < 5e-7 else f"{100 * error:+.1e}" if size < 1e-3 else f"{100 * error:+.2g}"


def page(measured: dict[str, dict[str, list[dict]]]) -> str:
    """Markdown of all rows: measured[precision][name] is a list of rows as dictionaries."""
    lines = [
        HEAD,
        "| test | quantity | reference | found | error % | allowed % | finer: error % | double: error % |",
        "|---|" + "---|" * 7,
    ]
    for name, module in modules().items():
        title, _ = title_and_text(module)
        rows, double = measured["f32"][name], measured["f64"].get(name, [])
        for quantity in dict.fromkeys(row["quantity"] for row in rows):
            own = [row for row in rows if row["quantity"] == quantity]
            at = own[0]
            finer = ", ".join(f"{row['settings']}: {percent(row['error'])}" for row in own[1:])
            twice = [row for row in double if row["quantity"] == quantity]
            allowed = f"{100 * at['allowed']:.2g}" + (" (not met)" if abs(at["error"]) > at["allowed"] else "")
            unit = at["unit"] and f" {at['unit']}"
            cells = (
                f"[{title}](#{anchor(title)})" if quantity == rows[0]["quantity"] else "",
                quantity,
                f"{at['reference']:.5g}{unit}",
                f"{at['found']:.5g}{unit}",
                percent(at["error"]),
                allowed,
                finer,
                percent(twice[0]["error"]) if twice else "",
            )
            lines.append("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |")
    for module in modules().values():
        title, text = title_and_text(module)
        cause = getattr(module, "CAUSE", "")
        lines += ["", f"## {title}", "", text + (f" **Not met:** {cause}" if cause else "")]
        file = Path(str(module.__file__)).name
        lines += [f"([{file}](../tests/published/{file}))"]
    return "\n".join(lines) + "\n"


def anchor(title: str) -> str:
    """Return what links call a heading."""
    return re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-")
