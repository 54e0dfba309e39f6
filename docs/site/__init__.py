"""What makes the site: settings of Sphinx, pages of the API, notebooks, pictures."""
