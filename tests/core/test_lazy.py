import sys

import pytest

from coopmap_env.core.lazy import load_on_first_use, typing_imports

SOURCE = """
import math
from typing import TYPE_CHECKING
if TYPE_CHECKING:
    import colorsys as colours
    from fractions import Fraction
    from decimal import Decimal as Number
else:
    from coopmap_env.core.lazy import load_on_first_use
    __getattr__ = load_on_first_use(__name__)
if math.pi:
    from json import loads
"""


@pytest.fixture
def package(tmp_path, monkeypatch):
    (tmp_path / "lazy_package.py").write_text(SOURCE)
    monkeypatch.syspath_prepend(tmp_path)
    import lazy_package

    yield lazy_package
    del sys.modules["lazy_package"]


def test_imports_for_type_checkers_are_read_from_the_source():
    assert dict(typing_imports(SOURCE)) == {
        "colours": ("colorsys", None),
        "Fraction": ("fractions", "Fraction"),
        "Number": ("decimal", "Decimal"),
    }


def test_a_name_is_loaded_on_first_use_and_kept(package):
    assert not {"Fraction", "Number", "colours"} & set(vars(package))
    assert package.Fraction(1, 2) == 0.5
    assert package.Number.__name__ == "Decimal"
    assert package.colours.__name__ == "colorsys"
    assert {"Fraction", "Number", "colours"} < set(vars(package))


def test_another_name_is_an_attribute_error(package):
    with pytest.raises(AttributeError, match="module 'lazy_package' has no attribute 'Fractions'"):
        package.Fractions  # noqa: B018
    assert not hasattr(package, "__path__")


def test_a_package_without_source_says_so(package, monkeypatch):
    monkeypatch.setattr(package.__spec__.loader, "get_source", lambda name: None)
    with pytest.raises(ImportError, match="lazy_package has no source"):
        load_on_first_use("lazy_package")("Fraction")
