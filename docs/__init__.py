"""Pages of the documentation; `python -m docs.site` makes a site of them."""
