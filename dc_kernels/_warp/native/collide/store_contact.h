// One contact's arrays: one native call, as each array store from Warp would load pointer and stride anew.
// Parameters: contacts, i, contact.
contacts.key.data[i] = contact.key;
contacts.body_a.data[i] = contact.body_a;
contacts.body_b.data[i] = contact.body_b;
contacts.normal.data[i] = contact.normal;
contacts.arm_a.data[i] = contact.arm_a;
contacts.arm_b.data[i] = contact.arm_b;
contacts.gap.data[i] = contact.gap;
contacts.friction.data[i] = contact.friction;
contacts.restitution.data[i] = contact.restitution;
