"""Collection: the tests in `libraries` need a learning library each; `make learn-test` names them."""

collect_ignore = ["libraries"]
