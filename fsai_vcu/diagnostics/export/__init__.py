"""Logs as tables for other tools: CSV, Parquet, MCAP, MF4; one table per message, or one wide table at a raster."""
