"""Body estimation: from landmarks and silhouettes to shape and poses."""
