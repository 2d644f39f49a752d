"""Each public name has one import path; modules with an underscore stay inside of their package."""

import ast
import re
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[1]
API = ROOT / "docs" / "api" / "index.rst"
FOLDERS = {
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
    """`planar_v1` and `field_v1` are pages that gather what users of one environment need."""
    return {
        module: exported(tree) for module, tree in trees().items() if not module.endswith("_v1")
    }


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
