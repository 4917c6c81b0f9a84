"""What may be in the data, a class a kind.

    y = N nu + sum over terms of (offset + X beta) + e,   beta ~ N(mean, std²) within bounds

An effect of the catalogue, a number of the arm or a sensor that is far off, and a law without a
form are the same thing with other columns, another prior and another word in the report:

| class | what | columns X | prior of beta |
|---|---|---|---|
| `EffectTerm` | an effect of the catalogue | its law, derivatives by theta | range |
| `KnownTerm` | what the description states or the user knows | its law | stated size, or range |
| `StatedTerm` | how far a stated size is off | its law | range |
| `NumberTerm` | a number that is far off | its column of N | wide |
| `UnnamedTerm` | the same, of no cause in the catalogue | its column of N | wide |
| `LawTerm` | a smooth function at one place | Gaussian process | size by evidence |
| `TurnoverTerm` | dry friction that turns over late | shares by distance | 0.5 |
| `CurveTerm` | dry friction whose curve bends | shapes of its curve | 0.1 |
| `ChangeTerm` | a size of its own in each recording | a term's, by recording | as of the term |
| `ShareTerm` | what an effect adds to columns of N | that part | none: never chosen |

Each class makes the terms that it becomes at another linearisation (`again`), its columns in Nm
(`plain`), and -ln of the prior odds of its kind (`doubt`). Two terms with one `ident` share their
products, so `_details` must hold all that changes the columns at one linearisation. A new kind is a
new file here. A report names it where `says_cause` is true (the default), and then
`diagnosis/estimates.py` states its sizes. A smooth function of one more quantity is no new kind,
but a law in `equations/formless.py`.
"""
