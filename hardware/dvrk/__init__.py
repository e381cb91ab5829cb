"""The da Vinci Research Kit over CRTK topics."""
