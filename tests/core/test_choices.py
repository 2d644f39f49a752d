import pytest

from coopmap_env.core.choices import check_keywords, unknown


def test_an_unknown_name_is_answered_with_the_nearest_and_all_choices():
    assert unknown("family", "crowd", ["crowded", "narrow"]) == (
        "unknown family 'crowd'; did you mean 'crowded'? Choose from crowded, narrow"
    )


@pytest.mark.parametrize("name", ["xyz", 3, None, "crowded" * 1000])
def test_where_nothing_is_near_all_choices_remain(name):
    text = unknown("family", name, ["crowded", "narrow"])
    assert text.endswith("; choose from crowded, narrow")
    assert len(text) < 200


def test_without_choices_the_message_says_so():
    assert unknown("policy", "a", []) == "unknown policy 'a'; choose from none"


def function(n_robots=2, *, split="train"):
    pass


def test_known_keywords_pass():
    check_keywords("function", ["split", "n_robots"], function)
    check_keywords("dict", ["anything"], lambda **options: None)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("robots", "function has no argument 'robots'; did you mean 'n_robots'? It takes n_robots"),
        ("xyz", "function has no argument 'xyz'; it takes n_robots, split"),
    ],
)
def test_an_unknown_keyword_is_a_type_error_that_names_the_known_ones(name, message):
    with pytest.raises(TypeError) as raised:
        check_keywords("function", [name], function)
    assert str(raised.value).startswith(message)
