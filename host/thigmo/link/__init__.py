"""Bytes to typed messages: transports, framing, requests, clock."""
