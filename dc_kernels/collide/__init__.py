"""From shapes to contacts: broadphase, narrowphase, matching, colours."""
