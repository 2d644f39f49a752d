import pytest

from coopmap_env.localization import CorrectionSettings, RegistrationSettings


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ({"patch_model_std": None}, "patch_model_std must be a finite number >= 0, got None"),
        ({"patch_model_std": -0.1}, "patch_model_std must be a finite number >= 0, got -0.1"),
        ({"max_sources": 2.5}, "max_sources must be an integer >= 1, got 2.5"),
        ({"max_keyframes": 0}, "max_keyframes must be an integer >= 1, got 0"),
        ({"outlier_sigmas": 0.0}, "outlier_sigmas must be a finite number > 0, got 0.0"),
        ({"target_spacing": 0.0}, "target_spacing must be a finite number > 0, got 0.0"),
    ],
)
def test_correction_settings_out_of_range_are_rejected_with_their_value(setting, message):
    with pytest.raises(ValueError, match=message):
        CorrectionSettings(**setting)


@pytest.mark.parametrize("n_hypotheses", [0, 2.5, True, "six"])
def test_the_number_of_hypotheses_is_a_positive_integer(n_hypotheses):
    with pytest.raises(ValueError, match="n_hypotheses must be an integer >= 1"):
        RegistrationSettings(n_hypotheses=n_hypotheses)
