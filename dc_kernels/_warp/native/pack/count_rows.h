// Rows at each body of the contacts i0 .. i1, added to those it has. Parameters: contacts, body_rows, i0, i1.
for (int i = i0; i < i1; ++i) ++body_rows.data[contacts.body_a.data[i]];
for (int i = i0; i < i1; ++i) ++body_rows.data[contacts.body_b.data[i]];
