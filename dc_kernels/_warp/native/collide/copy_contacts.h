// What persists of the contacts i0 .. i1, into the cache. Parameters: contacts, cache, i0, i1.
for (int i = i0; i < i1; ++i) cache.key.data[i] = contacts.key.data[i];
for (int i = i0; i < i1; ++i) cache.impulse.data[i] = contacts.impulse.data[i];
for (int i = i0; i < i1; ++i) cache.color.data[i] = contacts.color.data[i];
for (int i = i0; i < i1; ++i) cache.age.data[i] = contacts.age.data[i];
