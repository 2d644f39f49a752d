import pytest

from coopmap_env.localization import CorrectionSettings, RegistrationSettings


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ({"patch_std": None}, "patch_std must be finite and >= 0, got None"),
        ({"patch_std": -0.1}, "patch_std must be finite and >= 0, got -0.1"),
        ({"sources": 2.5}, "sources must be a whole number >= 1, got 2.5"),
        ({"keyframes": 0}, "keyframes must be a whole number >= 1, got 0"),
        ({"outlier_sigmas": 0.0}, "outlier_sigmas must be > 0"),
        ({"target_spacing": 0.0}, "target_spacing must be > 0"),
    ],
)
def test_correction_settings_refuse_what_makes_no_sense(setting, message):
    with pytest.raises(ValueError, match=message):
        CorrectionSettings(**setting)


@pytest.mark.parametrize("candidates", [0, 2.5, True, "six"])
def test_candidates_of_a_registration_are_counted_in_whole_numbers(candidates):
    with pytest.raises(ValueError, match="candidates must be a whole number of at least 1"):
        RegistrationSettings(candidates=candidates)
