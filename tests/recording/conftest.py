"""What the tests of recordings share: the fixtures of the verbs that make and play them."""

from tests.cli.conftest import pair as pair
from tests.cli.conftest import registry as registry
