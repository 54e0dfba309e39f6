"""Reports: what is known of a model, on one page that prints well."""
