"""Common parts of the nodes: conversion of messages to arrays, parameters, diagnostics. Most of it
needs no ROS."""
