"""The ROS interface: messages to calls, results to messages. Nothing imports this package.

A node here is thin: it declares parameters, turns messages into arrays, calls the library and publishes the result.
What of that needs no ROS (:mod:`pairing`, :mod:`pacing`, :mod:`reference`) stands in modules of its own.
"""
