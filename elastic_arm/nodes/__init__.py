"""The ROS interface: messages to calls, results to messages. Nothing imports this package.

A node here is thin: it declares parameters, turns messages into arrays, calls the library and
publishes the result. What of that needs no ROS (:mod:`.support.pairing`,
:mod:`.following.reference`) stands in modules of its own.
"""

import os

from elastic_arm.blas import one_blas_thread

one_blas_thread(os.environ)  # a node's modules import NumPy
