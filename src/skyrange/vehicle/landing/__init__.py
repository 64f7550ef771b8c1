"""Emergency landing of an aircraft on a flat place that its companion finds with a range sensor that looks down."""
