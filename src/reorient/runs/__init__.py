"""Resumable measurement runs: atomic files, raw rows, provenance, worker pools."""
