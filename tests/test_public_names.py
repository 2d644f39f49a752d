"""Each public name has one import path; modules with an underscore stay inside of their package."""

import ast
import re
from functools import cache
from pathlib import Path

from coopmap_env.core.lazy import typing_imports

ROOT = Path(__file__).parents[1]
API = ROOT / "docs" / "api" / "index.rst"
FOLDERS = {
    "coopmap": "coopmap",
    "coopmap_env": "coopmap_env",
    "agents": "coopmap_agents",
    "baselines": "coopmap_baselines",
}


def module_name(path):
    top, *rest = path.relative_to(ROOT).with_suffix("").parts
    return ".".join([FOLDERS[top], *rest]).removesuffix(".__init__")


@cache  # not read by every process that only collects tests
def trees():
    return {
        module_name(path): ast.parse(path.read_text(encoding="utf-8"))
        for folder in FOLDERS
        for path in sorted((ROOT / folder).rglob("*.py"))
    }


def exported(tree):
    for node in tree.body:
        if isinstance(node, ast.Assign) and getattr(node.targets[0], "id", "") == "__all__":
            return ast.literal_eval(node.value)
    return []


def all_exports():
    """By package; those that gather names of others for users are left out."""
    pages = ("coopmap", "coopmap_env.planar_v1", "coopmap_env.field_v1")
    return {module: exported(tree) for module, tree in trees().items() if module not in pages}


def imports():
    """Importing module, imported module and name of every import of ours."""
    for module, tree in trees().items():
        for node in ast.walk(tree):
            if isinstance(node, ast.ImportFrom) and node.module in trees():
                for alias in node.names:
                    yield module, node.module, alias.name


def room(module):
    """`coopmap_env.mapping` of any of its modules; agents and baselines are a room each."""
    parts = module.split(".")
    return ".".join(parts[:2] if parts[0] == "coopmap_env" else parts[:1])


def test_no_name_is_exported_by_two_packages():
    names = [name for exports in all_exports().values() for name in exports]
    names.remove("make")  # `coopmap_baselines.make` and `coopmap_env.families.make`
    assert sorted(name for name in set(names) if names.count(name) > 1) == []


def test_other_rooms_import_public_names_from_the_package_that_exports_them():
    package_of = {name: module for module, names in all_exports().items() for name in names}

    def bypasses(importer, module, name):
        package = package_of.get(name, "")
        inside = package and module.startswith(f"{package}.")
        return inside and package != "coopmap_env" and room(importer) != room(module)

    assert [found for found in imports() if bypasses(*found)] == []


def test_coopmap_gathers_public_names_under_their_own_names():
    page = ROOT / "coopmap" / "__init__.py"
    homes = dict(typing_imports(page.read_text(encoding="utf-8")))
    assert sorted([*homes, "__version__"]) == sorted(exported(trees()["coopmap"]))
    for name, (home, original) in homes.items():
        if original is not None:
            exports = exported(trees()[home])
            assert name == original, home
            assert name in exports or not exports, home


def test_what_is_loaded_on_first_use_is_not_hidden_by_a_module():
    """Importing the module would make it the attribute, in place of the name."""
    for module, tree in trees().items():
        source = ast.unparse(tree)
        if "load_on_first_use(__name__)" in source and module != "coopmap_env.core.lazy":
            for name, (home, original) in typing_imports(source):
                assert original is None or f"{module}.{name}" not in trees(), (module, home)


def test_underscored_modules_stay_inside_of_their_package():
    def escapes(importer, module, name):
        target = f"{module}.{name}" if f"{module}.{name}" in trees() else module
        package, _, last = target.rpartition(".")
        return last.startswith("_") and not f"{importer}.".startswith(f"{package}.")

    assert [found for found in imports() if escapes(*found)] == []


def test_the_api_reference_has_every_package_with_public_names():
    """The pages of the environments have `planar_v1`, `field_v1`; `coopmap_env` only gathers."""
    listed = re.findall(r"^   (coopmap_[\w.]+)$", API.read_text(encoding="utf-8"), re.MULTILINE)
    packages = {module for module, names in all_exports().items() if names}
    modules = {"coopmap_env", "coopmap_env.envs.planar.observations"}
    assert sorted(listed) == sorted(packages - modules)
