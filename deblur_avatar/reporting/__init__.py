"""Reports: tables, charts, strips, pages."""
