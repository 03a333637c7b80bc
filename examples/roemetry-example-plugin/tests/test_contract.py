"""The stage keeps the contract of its kind, on scenes whose answer is known."""

from roemetry.testing import parametrize_stages


@parametrize_stages("roemetry-example-plugin")
def test_contract(stage, check):
    check(stage)
