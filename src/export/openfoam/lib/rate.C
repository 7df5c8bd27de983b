    const volVectorField U_{{name}}(FAVRE_INTERFACE.{{phase}}().U());
    // sqrt(2 Sd:Sd), Sd the deviator of the symmetric gradient
    const volScalarField {{name}}(sqrt(2.0)*mag(dev(symm(fvc::grad(U_{{name}})()))));
