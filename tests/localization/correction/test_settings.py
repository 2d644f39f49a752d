import pytest

from coopmap_env.localization import CorrectionSettings, RegistrationSettings


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ({"patch_model_std": None}, "patch_model_std must be finite and >= 0, got None"),
        ({"patch_model_std": -0.1}, "patch_model_std must be finite and >= 0, got -0.1"),
        ({"max_sources": 2.5}, "max_sources must be a whole number >= 1, got 2.5"),
        ({"max_keyframes": 0}, "max_keyframes must be a whole number >= 1, got 0"),
        ({"outlier_sigmas": 0.0}, "outlier_sigmas must be > 0"),
        ({"target_spacing": 0.0}, "target_spacing must be > 0"),
    ],
)
def test_correction_settings_refuse_what_makes_no_sense(setting, message):
    with pytest.raises(ValueError, match=message):
        CorrectionSettings(**setting)


@pytest.mark.parametrize("n_hypotheses", [0, 2.5, True, "six"])
def test_candidates_of_a_registration_are_counted_in_whole_numbers(n_hypotheses):
    with pytest.raises(ValueError, match="n_hypotheses must be a whole number of at least 1"):
        RegistrationSettings(n_hypotheses=n_hypotheses)
