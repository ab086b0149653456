"""The browser page on viser: it shows Traces and sends commands; it computes nothing."""
