// Rolling resistance of contact c, and with it the radius of what rolls; 0 where it has no such row.
// Parameters: c, w, model, contacts. Stands behind surface.h.
return RADIUS ? radius_of(c) : resistance_of(c);
