"""Examples by hypothesis: the same in every run, few, and none kept on disk."""

from hypothesis import HealthCheck, Phase, settings

settings.register_profile(
    "fieldmap",
    derandomize=True,
    database=None,
    deadline=None,
    max_examples=25,
    # A failing example is shown as it was found: to make it smaller takes minutes.
    phases=[Phase.explicit, Phase.generate],
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
settings.load_profile("fieldmap")
