"""`python -m elastic_arm` is `elastic-arm`."""

from elastic_arm.app import main

main()
