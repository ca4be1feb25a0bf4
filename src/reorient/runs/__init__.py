"""Resumable measurement runs: files that are whole or absent, provenance, worker pools."""
