"""Settings of hypothesis: the same few examples in every run, and no database on disk."""

from hypothesis import HealthCheck, Phase, settings

settings.register_profile(
    "fieldmap",
    derandomize=True,
    database=None,
    deadline=None,
    max_examples=25,
    # A failing example is not shrunk, because shrinking takes minutes.
    phases=[Phase.explicit, Phase.generate],
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
settings.load_profile("fieldmap")
