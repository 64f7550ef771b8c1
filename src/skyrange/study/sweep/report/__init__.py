"""Report of a study: means with intervals, responses to factors, figures, and the page of them."""
