"""Browser page on viser: shows Traces and sends commands, computes nothing."""
