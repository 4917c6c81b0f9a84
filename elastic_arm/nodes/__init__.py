"""The ROS interface: it converts messages to calls and results to messages. Nothing imports this
package.

A node is thin: it declares parameters, converts messages to arrays, calls the library and publishes
the result. Parts that need no ROS (:mod:`.support.pairing`, :mod:`.following.reference`) are
separate modules.
"""

import os

from elastic_arm.blas import one_blas_thread

one_blas_thread(os.environ)  # a node's modules import NumPy
